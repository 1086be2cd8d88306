"""What the graph's perception finds in the contexts of a clip: frames -> tracks."""

from collections.abc import Mapping

from bench.tracking.camera import Camera
from bench.tracking.replaced import Replaced
from bench.tracking.stages import Stages
from pipeline.messages import Tracks

PERCEPTION = ("downsample", "saliency", "association")  # the stages from context to tracks


def watched(
    camera: Camera, stages: Stages, frames: int, replaced: Replaced
) -> Mapping[int, Tracks]:
    """Return the tracks that saliency and association find in the context of every frame."""
    stages.begin(camera.header(0), *PERCEPTION)
    found = {}
    for frame in range(frames):
        small = stages.call("downsample", frame=camera.context(frame, frame))
        seen = replaced.detections(stages.call("saliency", frame=small), frame)
        found[frame] = stages.call("association", detections=seen)
    return found
