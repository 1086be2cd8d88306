"""Where memory lies, told so that two processes can compare it: file and offset, not address."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class _Mapping:
    """A part of the address space, and the file behind it."""

    begin: int
    end: int
    offset: int
    file: str  # device and inode


class Places:
    """Files and offsets behind addresses of this process. Mappings are read when one is new.

    Memory without a file, whose contents no other process sees, has the place "".
    """

    def __init__(self, listing: Path = Path("/proc/self/maps")) -> None:
        self._listing = listing
        self._known: list[_Mapping] = []

    def of(self, address: int) -> str:
        """Return the place of an address, e.g. `00:1a 4711 +4096`."""
        found = self._covering(address)
        if found is None:
            self._known = list(_mappings(self._listing.read_text()))
            found = self._covering(address)
        if found is None or found.file.endswith(" 0"):
            return ""
        return f"{found.file} +{found.offset + address - found.begin}"

    def _covering(self, address: int) -> _Mapping | None:
        return next((m for m in self._known if m.begin <= address < m.end), None)


def _mappings(listing: str) -> Iterator[_Mapping]:
    """Yield the lines of `/proc/self/maps`: range, rights, offset, device, inode, path."""
    for line in listing.splitlines():
        addresses, _, offset, device, inode, *_ = line.split(maxsplit=5)
        begin, end = (int(side, 16) for side in addresses.split("-"))
        yield _Mapping(begin, end, int(offset, 16), f"{device} {inode}")
