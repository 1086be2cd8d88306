"""What the graph's perception finds in a strategy's own pictures: frames -> tracks, once a clip.

A strategy with a ROI has its context; the others have the picture that they read. A strategy that
leaves frames out has tracks for each phase of its exposures, because association has a state.
"""

from collections.abc import Mapping

from bench.tracking.camera import Camera
from bench.tracking.replaced import Replaced
from bench.tracking.stages import Stages
from pipeline.messages import Detections, Tracks

PERCEPTION = ("downsample", "saliency", "association")  # the stages from context to tracks


class Sight:
    """The tracks of a clip, found where they are first asked for, and kept."""

    def __init__(self, frames: int) -> None:
        self._frames = frames
        self._detections: dict[int, Detections] = {}
        self._tracks: dict[int, Mapping[int, Tracks]] = {}

    def tracks(
        self, camera: Camera, stages: Stages, replaced: Replaced, exposure: int
    ) -> Mapping[int, Tracks]:
        """Return the tracks of each exposure of the row that has an exposure in this frame."""
        phase = exposure % camera.how.sampling.interval
        if phase not in self._tracks:
            self._tracks[phase] = self._found(camera, stages, replaced, phase)
        return self._tracks[phase]

    def _found(
        self, camera: Camera, stages: Stages, replaced: Replaced, phase: int
    ) -> Mapping[int, Tracks]:
        how = camera.how.sampling
        first = phase if not how.averaged or phase == how.interval - 1 else phase + how.interval
        stages.begin(camera.header(0), *PERCEPTION)
        found = {}
        for frame in range(first, self._frames, how.interval):
            if frame not in self._detections:
                context = camera.context(frame, max(frame - how.interval + 1, 0))
                small = stages.call("downsample", frame=context)
                seen = stages.call("saliency", frame=small)
                self._detections[frame] = replaced.detections(seen, frame)
            found[frame] = stages.call("association", detections=self._detections[frame])
        return found


def watched(
    camera: Camera, stages: Stages, frames: int, replaced: Replaced
) -> Mapping[int, Tracks]:
    """Return the tracks that saliency and association find in the contexts of a clip's frames."""
    return Sight(frames).tracks(camera, stages, replaced, 0)
