"""Small descriptions of cameras (GenICam XML): a few words in, text out."""

from collections.abc import Iterable, Sequence

HEAD = (
    '<?xml version="1.0" encoding="utf-8"?>\n<RegisterDescription ModelName="{model}" '
    'VendorName="Fovea" StandardNameSpace="None" SchemaMajorVersion="1" SchemaMinorVersion="1" '
    'SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
    'ToolTip="" ProductGuid="0" VersionGuid="0" '
    'xmlns="http://www.genicam.org/GenApi/Version_1_1">'
)
REGISTER = (
    '<IntReg Name="{name}Register"><Address>0x{address:x}</Address><Length>4</Length>'
    "<AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign>"
    "<Endianess>BigEndian</Endianess></IntReg>"
)


def integer(
    name: str, address: int, low: int, high: int | str, *, step: int = 1, lock: str = ""
) -> str:
    """A whole number in a register; `high` may name a node."""
    most = f"<pMax>{high}</pMax>" if isinstance(high, str) else f"<Max>{high}</Max>"
    locked = f"<pIsLocked>{lock}</pIsLocked>" if lock else ""
    return (
        f'<Integer Name="{name}">{locked}<pValue>{name}Register</pValue><Min>{low}</Min>{most}'
        f"<Inc>{step}</Inc></Integer>{REGISTER.format(name=name, address=address)}"
    )


def choice(name: str, address: int, entries: Sequence[tuple[str, int]], *, lock: str = "") -> str:
    """An enumeration in a register."""
    locked = f"<pIsLocked>{lock}</pIsLocked>" if lock else ""
    told = "".join(
        f'<EnumEntry Name="{entry}"><Value>{value}</Value></EnumEntry>' for entry, value in entries
    )
    return (
        f'<Enumeration Name="{name}">{told}{locked}<pValue>{name}Register</pValue></Enumeration>'
        f"{REGISTER.format(name=name, address=address)}"
    )


def command(name: str, address: int, *, lock: str = "", value: int = 1) -> str:
    """A command, executed by writing a register."""
    locked = f"<pIsLocked>{lock}</pIsLocked>" if lock else ""
    return (
        f'<Command Name="{name}">{locked}<pValue>{name}Register</pValue>'
        f"<CommandValue>{value}</CommandValue></Command>"
        f"{REGISTER.format(name=name, address=address)}"
    )


def constant(name: str, value: int) -> str:
    """A number that never changes."""
    return f'<Integer Name="{name}"><Value>{value}</Value></Integer>'


def formula(name: str, text: str, **variables: str) -> str:
    """A value computed from others."""
    told = "".join(f'<pVariable Name="{key}">{node}</pVariable>' for key, node in variables.items())
    return f'<IntSwissKnife Name="{name}">{told}<Formula>{text}</Formula></IntSwissKnife>'


def whole(nodes: Iterable[str], *, model: str = "Virtual") -> bytes:
    """A whole description."""
    text = HEAD.format(model=model) + "".join(nodes) + '<Port Name="Device"/></RegisterDescription>'
    return text.encode()
