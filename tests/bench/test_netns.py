"""Network namespaces of hosts are removed, even if not all of them could be made."""

import os
import subprocess
from pathlib import Path

import pytest

from bench.netns import Hosts, permitted

pytestmark = pytest.mark.skipif(not permitted(), reason="network namespaces are not permitted here")


def own_namespaces() -> set[str]:
    shown = subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, check=True)
    names = {line.split()[0] for line in shown.stdout.splitlines()}
    return {name for name in names if name.startswith(f"fv{os.getpid()}-")}


def test_hosts_that_cannot_all_be_made_leave_no_namespace(tmp_path: Path) -> None:
    hosts = Hosts(tmp_path, "here", "there")
    hosts.home("there").touch()  # where a folder has to be made

    with pytest.raises(FileExistsError), hosts:
        pass

    assert own_namespaces() == set()
