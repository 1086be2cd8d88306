"""Tell objects by what the ROI showed of them: Tracks and RoiFeatures -> Tracks with identities.

The context says where objects are and loses who they are where they cross, are hidden or leave a
gap; the ROI shows at full resolution who somebody is. A track keeps its identity by motion alone
until there is a reason for doubt: it began, was found again after a gap, or overlapped another
one. When the ROI has shown it since, it is compared with what it was before, with identities that
were lost where it could have come from, and with those that it overlapped.
"""

from dataclasses import dataclass

import numpy as np

from operators.identity.deciding import Rules, decided
from operators.identity.people import People, looked, nobody, remembered, seen
from pipeline import Header, Input, Operator, RoiFeatures, SettingsError, Tracks
from pipeline.messages import altered

PER_TRACK = ("labels", "scores", "boxes", "visible", "features", "predicted")


@dataclass(frozen=True, kw_only=True)
class IdentitySettings:
    """What a graph may set."""

    looks: int = 3  # of a track in doubt before it is compared
    patience: int = 6  # looks after which a track that is like nobody is somebody new
    likeness: float = 0.8  # least correlation of mean looks with a lost or exchanged identity
    margin: float = 0.02  # by which another identity must be more like it than its own
    speed: float = 0.5  # box sizes a frame, within which a lost object may be found again
    memory: int = 250  # frames for which a lost identity may be found again
    most_lost: int = 50  # identities remembered
    most_looks: int = 100  # about as many are in the mean
    coasted: int = 2  # frames without detection after which a track is in doubt
    overlap: float = 0.3  # IoU from which two tracks may be confused

    def __post_init__(self) -> None:
        for name in ("looks", "patience", "most_looks"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name}: must be at least 1, got {getattr(self, name)}")
        for name in ("margin", "speed", "memory", "most_lost", "coasted"):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must be at least 0, got {getattr(self, name)}")
        if not -1 <= self.likeness <= 1:
            raise SettingsError(f"likeness: must be within -1..1, got {self.likeness}")
        if not 0 < self.overlap <= 1:
            raise SettingsError(f"overlap: must be above 0 and at most 1, got {self.overlap}")

    @property
    def rules(self) -> Rules:
        """When a track is who."""
        return Rules(
            looks=self.looks,
            likeness=self.likeness,
            margin=self.margin,
            speed=self.speed,
            memory=self.memory,
            patience=self.patience,
        )


class Identity(Operator[IdentitySettings, Tracks]):
    """Sends the tracks of each frame, with identities as ids, ordered by them.

    An identity is never reused in a stream. What the ROI never showed has an identity for as long
    as its track lasts. The ids of the features are those of the incoming tracks.
    """

    tracks = Input(Tracks, keep="every")
    features = Input(RoiFeatures, join=False)

    def open(self) -> None:
        """Start without identities."""
        self._people = nobody()

    def on_stream(self, header: Header) -> None:
        """Forget everybody: objects of another stream are different ones."""
        self._people = nobody()

    def state(self) -> People:
        """Return the table of identities."""
        return self._people

    def restore(self, state: People) -> None:
        """Take over the identities of another instance."""
        self._people = state

    def on_features(self, features: RoiFeatures) -> None:
        """Remember how the tracks in the ROI look."""
        s = self.settings
        self._people = looked(self._people, features.ids, features.features, s.most_looks)

    def on_tracks(self, tracks: Tracks) -> Tracks:
        """Decide what the ROI has shown so far, and name the tracks of this frame."""
        s = self.settings
        people = seen(self._people, tracks, coasted=s.coasted, overlap=s.overlap)
        people = decided(people, s.rules)
        self._people = remembered(people, s.memory, s.most_lost)
        ids = self._people.ids[self._people.rows_of(tracks.ids)].astype(np.int32)
        order = np.argsort(ids)
        parts = {name: getattr(tracks, name)[order] for name in PER_TRACK}
        return altered(tracks, ids=ids[order], **parts)
