"""Damaged descriptions of cameras: a GenICam XML and a seed in, the XML with a few changes out."""

import random
import re
from collections.abc import Callable

WORDS = (
    b"", b"0", b"-1", b"1", b"4294967295", b"99999999999999999999", b"0x", b"1e999", b"\xff\xfe",
    b"Width", b"WidthRegister", b"OffsetX", b"TLParamsLocked", b"Nothing", b"a" * 3000, b"&amp;",
    b"]]>", b"<!DOCTYPE x [<!ENTITY y 'z'>]>", b"<Value>1</Value>", b"(", b"1/0", b"A?B", b"1<<70",
    b"&y;", b"((((((((((" * 200, b"V*V*V*V", b"9" * 400, b"<Group>" * 40,
)  # fmt: skip
# ten entities, each ten times the one before: 10 billion words where they are expanded
LAUGHS = b"<!DOCTYPE l [<!ENTITY y0 'ha'>" + b"".join(
    b"<!ENTITY y%d '%s'>" % (k, b"&y%d;" % (k - 1) * 10) for k in range(1, 11)
) + b"<!ENTITY y '&y10;'>]>"  # fmt: skip
PROLOGUES = (
    LAUGHS, b"<!DOCTYPE l SYSTEM 'file:///etc/passwd'>", b"<?xml version='1.0'?>",
    b"<?xml version='1.0' encoding='utf-7'?>", b"<?xml version='1.0' encoding='UTF-16'?>",
    b"\xef\xbb\xbf", b"<!-- -->", b"<a/>", b"\0", b"",
)  # fmt: skip
_TEXT = re.compile(rb">([^<>]+)<")
_ELEMENT = re.compile(rb"<(\w+)(?: [^<>]*)?>[^<>]*</\1>")
_HEAD = re.compile(rb"\s*(<\?xml[^>]*>)?")

# formulas, converters, structures, enumerations and locks, each of them once
SMALL = b"""<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="Small" VendorName="Fovea" SchemaMajorVersion="1"
 xmlns="http://www.genicam.org/GenApi/Version_1_1">
<Group Comment="locks"><Integer Name="TLParamsLocked"><Value>0</Value></Integer></Group>
<Integer Name="SensorWidth"><Value>640</Value></Integer>
<Integer Name="SensorHeight"><Value>480</Value></Integer>
<Integer Name="Width"><pIsLocked>TLParamsLocked</pIsLocked><pValue>WidthRegister</pValue>
 <Min>8</Min><pMax>WidthMax</pMax><Inc>8</Inc></Integer>
<Integer Name="Height"><pValue>HeightRegister</pValue><Min>2</Min><Max>480</Max><Inc>2</Inc>
 </Integer>
<IntSwissKnife Name="WidthMax"><pVariable Name="BIN">BinningHorizontal</pVariable>
 <pVariable Name="FULL">SensorWidth</pVariable><Formula>(FULL / BIN) &amp; ~7</Formula>
 </IntSwissKnife>
<Integer Name="OffsetX"><pValue>OffsetXRegister</pValue><Min>0</Min><pMax>OffsetXMax</pMax>
 <Inc>8</Inc></Integer>
<Integer Name="OffsetY"><pValue>OffsetYRegister</pValue><Min>0</Min><Max>478</Max><Inc>2</Inc>
 </Integer>
<IntSwissKnife Name="OffsetXMax"><pVariable Name="W">Width</pVariable>
 <pVariable Name="M">WidthMax</pVariable><Constant Name="ZERO">0</Constant>
 <Expression Name="LEFT">M - W</Expression><Formula>LEFT &gt; 0 ? LEFT : ZERO</Formula>
 </IntSwissKnife>
<Integer Name="BinningHorizontal"><pValue>BinningRegister</pValue><Min>1</Min><Max>4</Max></Integer>
<Enumeration Name="BinningVertical"><EnumEntry Name="BinningVertical1"><Value>1</Value></EnumEntry>
 <EnumEntry Name="BinningVertical2"><Value>2</Value></EnumEntry><pValue>BinningRegister</pValue>
</Enumeration>
<Enumeration Name="PixelFormat"><EnumEntry Name="Mono8"><Value>0x01080001</Value></EnumEntry>
 <EnumEntry Name="BayerRG12Packed"><Value>0x010C002B</Value></EnumEntry>
 <EnumEntry Name="BayerRG10p"><Value>0x010A0058</Value></EnumEntry><pValue>FormatRegister</pValue>
</Enumeration>
<Enumeration Name="TriggerSource"><EnumEntry Name="Software"><Value>1</Value></EnumEntry>
 <pValue>TriggerRegister</pValue></Enumeration>
<Enumeration Name="TriggerMode"><EnumEntry Name="On"><Value>1</Value></EnumEntry>
 <pValue>TriggerRegister</pValue></Enumeration>
<Command Name="TriggerSoftware"><pValue>TriggerRegister</pValue><CommandValue>1</CommandValue>
 </Command>
<Float Name="AcquisitionFrameRate"><pValue>RateConverter</pValue><Min>0.5</Min><pMax>RateMax</pMax>
</Float>
<SwissKnife Name="RateMax"><pVariable Name="W">Width.Max</pVariable><Formula>3.5e4 / W ** 1.5
 </Formula></SwissKnife>
<Converter Name="RateConverter"><FormulaTo>1e6 / FROM</FormulaTo><FormulaFrom>1e6 / TO</FormulaFrom>
 <pValue>RateRegister</pValue></Converter>
<StructReg Comment="flags"><Address>0x40</Address><Length>4</Length><pPort>Device</pPort>
 <StructEntry Name="Flag"><Bit>3</Bit></StructEntry></StructReg>
<MaskedIntReg Name="TriggerRegister"><Address>0x30</Address><Length>4</Length><LSB>0</LSB>
 <MSB>7</MSB>
 <pPort>Device</pPort></MaskedIntReg>
<IntReg Name="WidthRegister"><Address>0x10</Address><IntSwissKnife Name="Place">
 <pVariable Name="F">Flag</pVariable><Formula>F * 4</Formula></IntSwissKnife><Length>4</Length>
 <AccessMode>RW</AccessMode><pPort>Device</pPort></IntReg>
<IntReg Name="HeightRegister"><Address>0x14</Address><Length>4</Length><pPort>Device</pPort>
 </IntReg>
<IntReg Name="OffsetXRegister"><Address>0x18</Address><Length>4</Length><pPort>Device</pPort>
 </IntReg>
<IntReg Name="OffsetYRegister"><Address>0x1C</Address><Length>4</Length><pPort>Device</pPort>
 </IntReg>
<IntReg Name="BinningRegister"><Address>0x20</Address><Length>4</Length><pPort>Device</pPort>
 </IntReg>
<IntReg Name="FormatRegister"><Address>0x24</Address><Length>4</Length><pPort>Device</pPort>
 </IntReg>
<IntReg Name="RateRegister"><Address>0x28</Address><Length>4</Length><pPort>Device</pPort></IntReg>
<Port Name="Device"/>
</RegisterDescription>
"""


def mutated(text: bytes, seed: int) -> bytes:
    """One to four changes of one kind each, the same for the same seed."""
    draw = random.Random(seed)
    for _ in range(draw.randint(1, 4)):
        text = draw.choice(CHANGES)(text, draw)
    return text


def _flip(text: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(max(len(text), 1))
    return text[:at] + bytes([draw.randrange(256)]) + text[at + 1 :]


def _reword(text: bytes, draw: random.Random) -> bytes:
    one = _place(_TEXT, text, draw)
    if one is None:
        return text
    others = [found[1] for _ in range(3) if (found := _place(_TEXT, text, draw))]
    return text[: one.start(1)] + draw.choice((*WORDS, *others)) + text[one.end(1) :]


def _cut(text: bytes, draw: random.Random) -> bytes:
    one = _place(_ELEMENT, text, draw)
    return text if one is None else text[: one.start()] + text[one.end() :]


def _repeat(text: bytes, draw: random.Random) -> bytes:
    one, place = _place(_ELEMENT, text, draw), _place(_ELEMENT, text, draw)
    if one is None or place is None:
        return text
    return text[: place.start()] + one[0] * draw.choice((1, 1, 50)) + text[place.start() :]


def _swap(text: bytes, draw: random.Random) -> bytes:
    pair = [one for _ in range(2) if (one := _place(_TEXT, text, draw))]
    if len(pair) < 2 or pair[0].start() == pair[1].start():
        return text
    first, second = sorted(pair, key=lambda one: one.start())
    return (
        text[: first.start(1)] + second[1] + text[first.end(1) : second.start(1)]
        + first[1] + text[second.end(1) :]
    )  # fmt: skip


def _end(text: bytes, draw: random.Random) -> bytes:
    return text[: draw.randrange(max(len(text), 1))] if draw.random() < 0.3 else text


def _begin(text: bytes, draw: random.Random) -> bytes:
    """Put something before the root, for which some texts then ask."""
    head = _HEAD.match(text)
    at = head.end() if head else 0
    changed = text[:at] + draw.choice(PROLOGUES) + text[at:]
    one = _place(_TEXT, changed, draw)
    if one is None or draw.random() < 0.5:
        return changed
    return changed[: one.start(1)] + b"&y;" + changed[one.end(1) :]


CHANGES: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    _flip, _reword, _cut, _repeat, _swap, _end, _begin,
)  # fmt: skip


def _place(
    pattern: re.Pattern[bytes], text: bytes, draw: random.Random
) -> "re.Match[bytes] | None":
    """The first match behind a random place: texts are too long to list all of them."""
    return pattern.search(text, draw.randrange(max(len(text), 1))) or pattern.search(text)
