"""A made-up recording of a street for the tests of the policy that reads."""

from pathlib import Path

import numpy as np

from operators.policy.data import Recording, arrays
from operators.policy.reading.street import UNSCORED, Street
from pipeline import RoiFeatures, Truth
from tests.operators.policy.made_up_texts import STREET, tracks

ROI, CONTEXT = 6, 8  # channels
SIGNS = [(1, 200.0, 150.0, 20.0), (2, 1100.0, 600.0, 16.0), (3, 250.0, 200.0, 14.0)]
FOREIGN = (4, 640.0, 360.0, 18.0)


def street(folder: Path, frames: int = 24, seed: int = 5) -> Street:
    """Return a clip with three signs, of which two fit one window, and one in another script."""
    heard = []
    for seq in range(frames):
        seen = tracks(seq, *SIGNS, FOREIGN, channels=CONTEXT)
        truth = Truth(
            header=seen.header,
            boxes=seen.boxes[:, -1],
            ids=seen.ids + 100,
            labels=("STOP", "BAKERY", "OPEN", UNSCORED),
            visibility=np.ones(4, np.float32),
        )
        looks = RoiFeatures(
            header=seen.header,
            ids=seen.ids,
            features=np.tile(seen.ids[:, None], (1, ROI)).astype(np.float32),
            genuine=np.ones(4, np.float32),
        )
        heard.append({"association.out": seen, "capture.truth": truth, "roi_features.out": looks})
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / f"{seed}.npz", allow_pickle=False, **arrays(heard))
    found = Street(Recording(folder / f"{seed}.npz"))
    assert found.geometry == STREET
    return found
