"""What a street says: a random generator -> words on boards, signs and plates."""

import numpy as np

TRADES = (
    *("BAKERY", "BOOKS", "BUTCHER", "CAFE", "CYCLES", "DENTIST", "FLORIST", "FISH", "GARAGE"),
    *("GROCER", "HARDWARE", "HOTEL", "JEWELS", "KITCHENS", "LAUNDRY", "LIBRARY", "LIGHTS"),
    *("MARKET", "MUSIC", "OPTICIAN", "PHARMACY", "PIZZA", "POTTERY", "RECORDS", "SALON"),
    *("SHOES", "SPORTS", "STATION", "SURGERY", "TAILOR", "TEA ROOM", "THEATRE", "TICKETS"),
    *("TOYS", "TRAVEL", "WATCHES", "WINES", "BANK", "BARBER", "BISTRO", "CARPETS", "CINEMA"),
    *("FABRICS", "GALLERY", "GARDENS", "GLASS", "LOCKSMITH", "OFFICE", "PAINTS", "PRINTERS"),
)
FIRST = (
    *("AMBER", "ASH", "BRIGHT", "CASTLE", "CEDAR", "CLEAR", "COPPER", "CORNER", "CROWN", "EAST"),
    *("FERRY", "FOREST", "GOLDEN", "GRAND", "GREEN", "HARBOUR", "HILL", "IVY", "KINGS", "LAKE"),
    *("LITTLE", "LONG", "MAPLE", "MILL", "NEW", "NORTH", "OAK", "OLD", "PARK", "QUEENS", "RED"),
    *("RIVER", "ROSE", "ROYAL", "SILVER", "SOUTH", "SUMMER", "SWAN", "TOWER", "VALLEY", "WEST"),
)
NAMES = (
    *("Adams", "Baxter", "Carver", "Dalton", "Ellis", "Fletcher", "Garner", "Hobbs", "Ingram"),
    *("Jarvis", "Keane", "Lowell", "Marsh", "Norris", "Osborne", "Palmer", "Quigley", "Ramsey"),
    *("Sawyer", "Tanner", "Upton", "Vaughan", "Walton", "Yates", "Bowman", "Chandler", "Drake"),
)
PLACES = (
    *("Airport", "Ashford", "Bridge", "Brook", "Centre", "Church", "Docks", "Eastgate", "Exit"),
    *("Ferry", "Harbour", "Hospital", "Kingston", "Museum", "Newport", "Northgate", "Parking"),
    *("Ring Road", "Riverside", "School", "Stadium", "Station", "Westfield", "Zoo"),
)
ORDERS = ("STOP", "SLOW", "ONE WAY", "NO ENTRY", "GIVE WAY", "BUS LANE", "20", "30", "40", "50")
FOREIGN = (  # scripts that an English reader leaves alone
    *("ΚΑΦΕΝΕΙΟ", "ΦΑΡΜΑΚΕΙΟ", "ΒΙΒΛΙΑ", "ΠΛΑΤΕΙΑ", "ΞΕΝΟΔΟΧΕΙΟ", "АПТЕКА", "ХЛЕБ", "КНИГИ"),
    *("ЦВЕТЫ", "ПОЧТА", "МАГАЗИН", "ԳՐՔԵՐ", "ՀԱՑ", "ԴԵՂԱՏՈՒՆ", "წიგნები", "პური", "აფთიაქი"),
)
PLATES = "ABCDEFGHJKLMNPRSTUVWXYZ"
LETTERS = np.array(list(PLATES))
ENGLISH = (*TRADES, *FIRST, *NAMES, *PLACES, *ORDERS, PLATES, "0123456789", "& Sons")


def shop(rng: np.random.Generator) -> str:
    """Draw the name of a shop."""
    kind = rng.random()
    if kind < 0.45:
        return str(rng.choice(TRADES))
    if kind < 0.6:
        return str(rng.choice(NAMES))
    if kind < 0.8:
        return f"{rng.choice(FIRST)} {rng.choice(TRADES)}"
    name = str(rng.choice(NAMES))
    return f"{name} & Sons" if kind < 0.9 else f"{name} {rng.integers(1, 200)}"


def sign(rng: np.random.Generator) -> str:
    """Draw what a traffic sign says."""
    if rng.random() < 0.3:
        return str(rng.choice(ORDERS))
    place = str(rng.choice(PLACES))
    return f"{place} {rng.integers(1, 60)}" if rng.random() < 0.3 else place


def plate(rng: np.random.Generator) -> str:
    """Draw a number plate: two letters, two digits, three letters."""
    a, b = ("".join(rng.choice(LETTERS, count)) for count in (2, 3))
    return f"{a}{rng.integers(10, 80)} {b}"


def foreign(rng: np.random.Generator) -> str:
    """Draw a word that is not to be read."""
    return str(rng.choice(FOREIGN))
