"""What the graph's perception finds in the contexts of a clip: frames -> tracks."""

from collections.abc import Mapping

import numpy as np

from bench.tracking.camera import Camera
from bench.tracking.replaced import Replaced
from bench.tracking.stages import Stages
from pipeline.messages import Detections, Tracks, altered

PERCEPTION = ("downsample", "saliency", "association")  # the stages from context to tracks


def watched(
    camera: Camera, stages: Stages, frames: int, replaced: Replaced, *, missed: float = 0.0
) -> Mapping[int, Tracks]:
    """Return the tracks that saliency and association find in the context of every frame.

    `missed` is the share of detections that are left out, drawn by the frame's number.
    """
    stages.begin(camera.header(0), *PERCEPTION)
    found = {}
    for frame in range(frames):
        small = stages.call("downsample", frame=camera.context(frame, frame))
        seen = replaced.detections(stages.finds(small), frame)
        found[frame] = stages.tracks(without(seen, missed), small)
    return found


def without(seen: Detections, missed: float) -> Detections:
    """Return detections without a share of them, drawn by the frame's number."""
    if not missed:
        return seen
    kept = np.random.default_rng([seen.header.seq, 11]).random(len(seen.boxes)) >= missed
    parts = ("boxes", "angles", "scores", "labels", "features")
    return altered(seen, **{name: getattr(seen, name)[kept] for name in parts})
