"""Links between sensor and host: bytes a second in, a verdict by what each carries in practice out.

What a link carries may be planned with. Above that and up to the most that it can carry, cable,
controller and drivers decide: marginal. In MB/s:

- USB 2: 40, of 35 to 45 in practice. Most: 53.2, 13 bulk packets of 512 bytes in each of 8,000
  microframes (Universal Serial Bus 2.0, section 5.8.4, table 5-10).
- USB 3.0: 400, as cameras reach 350 to 450. Most: 450, of 500 after the 8b/10b code.
- USB 3.1 Gen 2: 1,000 in practice. Most: 1,090, the same share (0.9) of 1,212 after the 128b/132b
  code.
- GigE: 118, in Ethernet frames of 1,500 bytes: 1,464 of pixels in 1,538 on the wire (IEEE 802.3
  with the headers of IP, UDP and GigE Vision's GVSP). Most: 123.9, in jumbo frames of 9,000.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Verdict = Literal["fits", "marginal", "does not fit", "not known"]


@dataclass(frozen=True, kw_only=True)
class Link:
    """What a kind of link carries."""

    name: str
    carries_bytes_per_s: float  # that may be planned with
    most_bytes_per_s: float  # that good hardware reaches

    def verdict(self, needed: float | None) -> Verdict:
        """Judge a need in bytes a second; None is not known.

        >>> [LINKS["usb3.0"].verdict(mega * 1e6) for mega in (351, 439, 703)]
        ['fits', 'marginal', 'does not fit']
        """
        if needed is None:
            return "not known"
        if needed <= self.carries_bytes_per_s:
            return "fits"
        return "marginal" if needed <= self.most_bytes_per_s else "does not fit"


LINKS: Mapping[str, Link] = MappingProxyType(
    {
        "usb2": Link(name="USB 2", carries_bytes_per_s=40e6, most_bytes_per_s=53.2e6),
        "gige": Link(name="GigE", carries_bytes_per_s=118e6, most_bytes_per_s=123.9e6),
        "usb3.0": Link(name="USB 3.0", carries_bytes_per_s=400e6, most_bytes_per_s=450e6),
        "usb3.1": Link(name="USB 3.1 Gen 2", carries_bytes_per_s=1000e6, most_bytes_per_s=1090e6),
    }
)
