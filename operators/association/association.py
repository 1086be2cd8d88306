"""Track objects: Detections, and their Frame -> Tracks, with gaps filled and frames predicted.

Paper, section 3.3: Hungarian matching with the same class first, and a constant-velocity Kalman
filter on the centre. As in the paper, the size is not in the filter's state; it is smoothed
separately, since a velocity of the size, extrapolated over Tp frames, inflates or inverts boxes.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from operators.association.appearance import likeness, worn
from operators.association.kalman import extrapolate, motion_model
from operators.association.matching import Rows, match
from operators.association.table import Table, advance, born, box_sizes, empty, see, select
from pipeline import Detections, Frame, Geometry, Header, Input, Operator, SettingsError, Tracks
from pipeline.boxes import from_centres
from pipeline.errors import MessageError

AssociationState = Table
MOST_FRAMES = 1000  # of history, and predicted: the paper's longest have 10 and 200


@dataclass(frozen=True, kw_only=True)
class AssociationSettings:
    """What a graph may set; noises and the gate are the paper's (see kalman.py for their units)."""

    observed: int = 4  # To, frames of history
    horizon: int = 16  # Tp, predicted frames
    max_objects: int = 25
    iou_gate: float = 0.1
    process_noise: float = 0.001
    measurement_noise: float = 0.01
    confirm: int = 2  # detections before an object is reported
    max_missed: int = 12  # frames an object may stay undetected
    max_missed_unconfirmed: int = 2
    birth_score: float = 0.0  # detections below it continue tracks but start none
    small_share: float = 0.02  # of the field's width: smaller objects may also match by distance
    small_reach: float = 1.25  # distance limit of such a match, box sizes per frame; 0: off
    colour_difference: float = 40.0  # in CIELAB, at which likeness is .37; 0: colours count not

    def __post_init__(self) -> None:
        for name in ("observed", "horizon"):  # arrays of every message have as many rows
            if not 1 <= getattr(self, name) <= MOST_FRAMES:
                given = getattr(self, name)
                raise SettingsError(f"{name}: expected 1 to {MOST_FRAMES}, got {given}")
        for name in ("max_objects", "confirm"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name}: must be at least 1, got {getattr(self, name)}")
        for name in (
            "max_missed",
            "max_missed_unconfirmed",
            "small_share",
            "small_reach",
            "colour_difference",
        ):
            if getattr(self, name) < 0:
                raise SettingsError(f"{name}: must be at least 0, got {getattr(self, name)}")
        for name in ("process_noise", "measurement_noise"):
            if getattr(self, name) <= 0:
                raise SettingsError(f"{name}: must be above 0, got {getattr(self, name)}")
        for name in ("iou_gate", "birth_score"):
            if not 0 <= getattr(self, name) <= 1:
                raise SettingsError(f"{name}: must be within 0..1, got {getattr(self, name)}")


class Association(Operator[AssociationSettings, Tracks]):
    """Report at most `max_objects` confirmed objects, ordered by id; deterministic.

    With `frame`, the picture in which they were detected, objects are told apart by their colours,
    too. One without colours, or none, changes nothing.

    Raises `MessageError` when frames run backwards or the number of feature channels changes.
    """

    commands = ("forget",)
    detections = Input(Detections, keep="every")
    frame = Input(Frame, keep="every", optional=True)

    def open(self) -> None:
        """Start without objects."""
        s = self.settings
        self._model = motion_model(s.process_noise, s.measurement_noise)
        self._table = empty(s.observed, 0)

    def on_stream(self, header: Header) -> None:
        """Drop all objects: those of another stream are different ones."""
        self._table = empty(self.settings.observed, 0)

    def do_forget(self) -> dict[str, int]:
        """Drop every object, as at the start of a scene; ids are not reused."""
        forgotten, table = len(self._table.ids), self._table
        nobody = empty(self.settings.observed, table.features.shape[2], table.names)
        self._table = replace(nobody, seq=table.seq, next_id=table.next_id)
        return {"forgotten": forgotten}

    def state(self) -> Table:
        """Return the table of objects."""
        return self._table

    def restore(self, state: Table) -> None:
        """Take over the objects of another instance; raises `SettingsError` when To differs."""
        if state.boxes.shape[1] != self.settings.observed:
            raise SettingsError(
                f"observed: the state holds {state.boxes.shape[1]} frames, "
                f"expected {self.settings.observed}"
            )
        self._table = state

    def on_detections(self, detections: Detections) -> Tracks:
        """Track without a picture."""
        return self.on_detections_frame(detections, None)

    def on_detections_frame(self, detections: Detections, frame: Frame | None) -> Tracks:
        """Match and update tracks, end old ones, start new ones, and report."""
        s, table = self.settings, self._foreseen(detections)
        shown = frame if s.colour_difference else None
        colours = worn(detections.boxes, shown)

        def alike(track: Rows, seen: Rows) -> NDArray[np.float32]:
            return likeness(table.colours[track], colours[seen], s.colour_difference)

        pairs = match(
            table.boxes[:, -1],
            detections.boxes,
            table.labels[:, None] == detections.labels[None],
            iou_gate=s.iou_gate,
            reach_px=reaches(table, detections.header.geometry.width_px, s),
            likeness=alike if shown else None,
        )
        table = see(table, pairs, detections, colours, self._model)
        table = select(table, alive(table, detections.header.geometry, s))
        fresh = newcomers(detections.scores, pairs[:, 1], s.birth_score)
        # keep at most four objects per reported one, against detector noise
        fresh = np.sort(fresh[: max(4 * s.max_objects - len(table.ids), 0)])
        self._table = born(table, fresh, detections, colours, self._model)
        return self._report(detections.header)

    def _foreseen(self, detections: Detections) -> Table:
        """Return the table predicted for this frame, before matching."""
        s, table, seq = self.settings, self._table, detections.header.seq
        channels = detections.features.shape[1]
        if len(table.ids) and channels != table.features.shape[2]:
            raise MessageError(
                f"association: expected {table.features.shape[2]} feature channels, got {channels}"
            )
        if seq <= table.seq:
            raise MessageError(f"association: expected a frame after {table.seq}, got {seq}")
        if not len(table.ids) or seq - table.seq > s.max_missed + 1:
            nobody = empty(s.observed, channels, detections.names)
            return replace(nobody, seq=seq, next_id=table.next_id)
        return advance(table, seq, self._model)

    def _report(self, header: Header) -> Tracks:
        """Return the tracks to report, with their predictions."""
        s = self.settings
        kept = select(self._table, worth_telling(self._table, s.confirm, s.max_objects))
        ahead = extrapolate(kept.mean, np.arange(1, s.horizon + 1))
        sizes = np.broadcast_to(kept.size[:, None], ahead.shape)
        return Tracks(
            header=header,
            ids=kept.ids,
            labels=kept.labels,
            scores=kept.scores,
            boxes=kept.boxes,
            visible=kept.visible,
            features=kept.features,
            predicted=from_centres(ahead.astype(np.float32), sizes),
            names=kept.names,
        )


def reaches(table: Table, width_px: int, s: AssociationSettings) -> NDArray[np.float32]:
    """Return how far each small object may be from its prediction: (n,), pixels; 0 for others.

    A 16 px ball at 18 px per frame overlaps neither its last box nor, before the filter has
    learned its speed, its predicted one.
    """
    sizes = box_sizes(table)
    elapsed = (table.seq - table.last_seq).astype(np.float32)
    small = sizes <= s.small_share * width_px
    return np.where(small, s.small_reach * sizes * elapsed, np.float32(0))


def alive(table: Table, field: Geometry, s: AssociationSettings) -> NDArray[np.bool_]:
    """Return which objects to keep: (n,). Unseen ones end, sooner if unconfirmed or outside."""
    missed = table.seq - table.last_seq
    patience = np.where(table.hits >= s.confirm, s.max_missed, s.max_missed_unconfirmed)
    if not field.width_px:
        return np.asarray(missed <= patience)
    x, y = table.mean[:, 0], table.mean[:, 1]
    inside = (x >= 0) & (y >= 0) & (x <= field.width_px) & (y <= field.height_px)
    return np.asarray((missed == 0) | (inside & (missed <= patience)))


def newcomers(
    scores: NDArray[np.float32], matched: NDArray[np.int64], least: float
) -> NDArray[np.int64]:
    """Unmatched detections scored at least `least`: (m,), (k,) -> indices, best first."""
    fresh = np.setdiff1d(np.flatnonzero(scores >= least), matched)
    return np.asarray(fresh[np.argsort(-scores[fresh], kind="stable")])


def worth_telling(table: Table, confirm: int, most: int) -> NDArray[np.int64]:
    """Return the rows of at most `most` confirmed objects, ascending.

    The best object of every class has priority, rarest class first, so that 25 players do not
    displace the one ball; then score, then age.
    """
    rows = np.flatnonzero(table.hits >= confirm)
    if len(rows) <= most:
        return rows
    rows = rows[np.lexsort((table.ids[rows], -table.scores[rows]))]
    labels, first, count = np.unique(table.labels[rows], return_index=True, return_counts=True)
    envoys = first[np.lexsort((labels, count))]
    order = np.concatenate([envoys, np.setdiff1d(np.arange(len(rows)), envoys)])
    return np.sort(rows[order[:most]])
