"""Hosts in network namespaces: they are gone again, also when they could not all be made."""

import subprocess
from pathlib import Path

import pytest

from bench.netns import Hosts, permitted

pytestmark = pytest.mark.skipif(not permitted(), reason="network namespaces are not permitted here")


def namespaces() -> set[str]:
    shown = subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, check=True)
    return {line.split()[0] for line in shown.stdout.splitlines()}


def test_hosts_that_cannot_all_be_made_leave_no_namespace(tmp_path: Path) -> None:
    before = namespaces()
    hosts = Hosts(tmp_path, "here", "there")
    hosts.home("there").touch()  # where a folder has to be made

    with pytest.raises(FileExistsError), hosts:
        pass

    assert namespaces() <= before
