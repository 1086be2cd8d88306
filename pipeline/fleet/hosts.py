"""Where the agents of hosts are: words of the command line, or credentials -> end points."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from pipeline.errors import SettingsError
from pipeline.fleet.agent_file import local_endpoint
from pipeline.fleet.names import ANYBODY, endpoint, is_routed
from pipeline.fleet.secure import ADDRESSES, Credentials
from pipeline.naming import check_name


@dataclass(frozen=True)
class Hosts:
    """The end points of agents, and the credentials to contact them."""

    points: Mapping[str, str]  # label -> end point
    credentials: str = ""
    nodes: Mapping[str, str] = field(default_factory=dict)  # of a deployed graph: node -> label

    @property
    def identity(self) -> str:
        """The identity of the client."""
        return Credentials.of(Path(self.credentials)).identity if self.credentials else ANYBODY


def read_hosts(words: Iterable[str], credentials: Path | None, labels: Iterable[str] = ()) -> Hosts:
    """Return end points: from `LABEL=ADDRESS`, else from the credentials, else on this machine.

    `labels` are the required hosts, given or not. Raises `SettingsError`.
    """
    said = dict(word.partition("=")[::2] for word in ",".join(words).split(",") if word)
    known = known_addresses(credentials) if credentials else {}
    points = {}
    for label in dict.fromkeys([*labels, *said]):
        check_name(label, "--hosts", SettingsError)
        address = said.get(label) or known.get(label, "")
        if credentials and not address:
            raise SettingsError(f"--hosts: expected {label}=ADDRESS, as {credentials} knows none")
        points[label] = endpoint(address, f"--hosts {label}") if address else local_endpoint(label)
    if credentials is None and any(
        point.startswith("tls/") or is_routed(point) for point in points.values()
    ):
        raise SettingsError("--hosts: a network address needs --credentials, see `fovea secure`")
    return Hosts(points, str(credentials.resolve()) if credentials else "")


def known_addresses(credentials: Path) -> dict[str, str]:
    """Return the addresses that `fovea secure` stored with credentials: label -> address.

    Raises `SettingsError` for a folder that is not there, or a file that cannot be read.
    """
    if not credentials.is_dir():
        got = "no such folder; `fovea secure init` makes one"
        raise SettingsError(f"--credentials {credentials}: {got}")
    path = credentials / ADDRESSES
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, str])
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from error
    except (msgspec.MsgspecError, ValueError) as error:  # the latter: it is no UTF-8
        raise SettingsError(f"{path}: expected label: address, got {error}") from error
