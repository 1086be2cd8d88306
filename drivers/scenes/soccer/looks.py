"""Appearance of people: a seed -> kits, skin, hair, boots and numbers of all people."""

from dataclasses import dataclass, replace

import numpy as np

Colour = tuple[int, int, int]

SKINS: tuple[Colour, ...] = ((226, 180, 150), (205, 155, 120), (160, 110, 80), (95, 62, 45))
HAIRS: tuple[Colour, ...] = (
    (25, 20, 18),
    (60, 42, 28),
    (110, 80, 45),
    (170, 140, 90),
    (45, 40, 40),
)
BOOTS: tuple[Colour, ...] = (
    *((240, 240, 240), (235, 235, 225), (25, 25, 28), (30, 30, 35), (225, 250, 60)),
    *((250, 110, 40), (40, 120, 230), (240, 60, 120), (225, 30, 40), (90, 240, 160)),
)
KITS: tuple[Colour, ...] = (
    *((200, 30, 40), (235, 235, 235), (30, 60, 170), (20, 30, 70), (245, 210, 40)),
    *((25, 25, 28), (20, 120, 60), (120, 180, 230), (240, 110, 30), (110, 20, 45)),
    *((100, 40, 130), (60, 170, 160), (190, 190, 195)),
)
BRIGHT: tuple[Colour, ...] = (  # kits of officials, distinct from the teams
    *((225, 245, 40), (250, 90, 160), (90, 235, 120), (60, 210, 240), (255, 130, 60)),
)
PATTERNS = ("plain", "plain", "plain", "stripes", "hoops", "sash", "halves", "sleeves")


NAMES = (  # 22 of them are drawn for a match
    *("ADLER", "BRUNO", "CORTES", "DUBOIS", "EKDAL", "FERRI", "GARCIA", "HUGO", "IVANOV", "JANSEN"),
    *("KELLER", "LOPEZ", "MEYER", "NOVAK", "OLSEN", "PEREZ", "QUINN", "ROSSI", "SILVA", "TORRES"),
    *("URBAN", "VIDAL", "WEISS", "YILDIZ", "ZANETTI", "BECK", "COSTA", "DIAZ", "FISCHER", "NAGY"),
)


@dataclass(frozen=True, kw_only=True)
class Look:
    """One person's appearance, colours as RGB."""

    shirt: Colour
    trim: Colour
    pattern: str
    shorts: Colour
    socks: Colour
    boots: Colour
    skin: Colour
    hair: Colour
    hair_style: int  # 0 bald, 1 short, 2 full, 3 bun
    ink: Colour  # of the number
    number: str  # empty: none
    name: str  # above the number, empty: none
    height_m: float
    width: float  # relative
    long_sleeves: bool
    gloves: bool


def distant(rng: np.random.Generator, taken: list[Colour], choices: tuple[Colour, ...]) -> Colour:
    """Draw a colour that is distinct from those taken and from grass."""
    against = np.array([*taken, (70, 120, 50)], float)
    far = [c for c in choices if np.abs(against - c).sum(1).min() > 150]
    return far[int(rng.integers(len(far)))] if far else choices[int(rng.integers(len(choices)))]


def legible(on: Colour, rng: np.random.Generator) -> Colour:
    """Draw a colour of numbers that is legible on a shirt."""
    dark = sum(on) < 330
    light: tuple[Colour, ...] = ((245, 245, 245), (245, 225, 80))
    deep: tuple[Colour, ...] = ((20, 20, 25), (150, 20, 30), (20, 35, 110))
    return light[int(rng.random() < 0.15)] if dark else deep[int(rng.integers(3))]


def kit(rng: np.random.Generator, taken: list[Colour]) -> Look:
    """Draw a team's clothes; personal attributes have defaults."""
    shirt = distant(rng, taken, KITS)
    trim = distant(rng, [shirt], KITS)
    shorts = (shirt, trim, (240, 240, 240), (25, 25, 30))[
        int(rng.choice(4, p=[0.3, 0.3, 0.25, 0.15]))
    ]
    white: Colour = (240, 240, 240)
    socks = (shirt, trim, white, shorts)[int(rng.choice(4, p=[0.35, 0.15, 0.35, 0.15]))]
    return Look(
        shirt=shirt,
        trim=trim,
        pattern=str(rng.choice(PATTERNS)),
        shorts=shorts,
        socks=socks,
        boots=BOOTS[0],
        skin=SKINS[0],
        hair=HAIRS[0],
        hair_style=1,
        ink=legible(shirt, rng),
        number="",
        name="",
        height_m=1.8,
        width=1.0,
        long_sleeves=False,
        gloves=False,
    )


def person(rng: np.random.Generator, clothes: Look, number: str) -> Look:
    """Draw the personal attributes of a person in these clothes."""
    return replace(
        clothes,
        boots=BOOTS[int(rng.integers(len(BOOTS)))],
        skin=SKINS[int(rng.choice(len(SKINS), p=[0.35, 0.3, 0.2, 0.15]))],
        hair=HAIRS[int(rng.integers(len(HAIRS)))],
        hair_style=int(rng.choice(4, p=[0.1, 0.45, 0.35, 0.1])),
        number=number,
        height_m=float(np.clip(rng.normal(1.81, 0.055), 1.66, 1.98)),
        width=float(np.clip(rng.normal(1.0, 0.06), 0.86, 1.15)),
        long_sleeves=bool(rng.random() < 0.25) or clothes.long_sleeves,
    )


def everybody(seed: int) -> tuple[Look, ...]:
    """Draw the looks of the 25 people in the order of `play.LABELS`."""
    rng = np.random.default_rng([seed, 10])
    home = kit(rng, [])
    away = kit(rng, [home.shirt])
    keepers = []
    taken = [home.shirt, away.shirt]
    for _ in range(2):
        keeper = kit(rng, taken)
        taken.append(keeper.shirt)
        keepers.append(replace(keeper, long_sleeves=True, gloves=True, pattern="plain"))
    dark: Colour = (25, 25, 28)
    official = replace(kit(rng, taken), pattern="plain", shorts=dark, socks=dark, number="")
    if rng.random() < 0.45:
        official = replace(official, shirt=distant(rng, taken, BRIGHT))
    if rng.random() < 0.35:
        official = replace(official, socks=official.shirt)
    looks = []
    for team in (home, away):
        numbers = rng.permutation(np.arange(2, 40))[:10]
        looks += [person(rng, team, str(number)) for number in numbers]
    looks += [person(rng, keeper, "1") for keeper in keepers]
    looks += [replace(person(rng, official, ""), boots=dark) for _ in range(3)]
    return tuple(looks)


def named(looks: tuple[Look, ...], seed: int) -> tuple[Look, ...]:
    """Return the looks with a name on each shirt that has a number."""
    names = iter(np.random.default_rng([seed, 11]).permutation(NAMES).tolist())
    return tuple(replace(look, name=next(names)) if look.number else look for look in looks)
