"""Format results of orders to running graphs as lines for a terminal."""

from pipeline.node.operator_state import lost_words
from pipeline.protocol.codec import fields_of
from pipeline.protocol.orders import ShadowReport, SwapResult, TopologyResult


def topology_lines(result: TopologyResult) -> list[str]:
    """Return a line per kind of change.

    >>> topology_lines(TopologyResult(added=["eye"], removed=[], connected=["a -> e.x"], cut=[]))
    ['added: eye', 'connected: a -> e.x']
    """
    return [f"{kind}: {', '.join(names)}" for kind, names in fields_of(result).items() if names]


def swap_lines(result: SwapResult, shadow: int = 0) -> list[str]:
    """Describe a completed swap, for which `shadow` frames of comparison were asked.

    >>> swap_lines(SwapResult(node="a", hot=True, seq=7, gap_ms=1.25, state="none",
    ...                       proven_frames=30))
    ['a: swapped after frame 7, paused for 1.2 ms, state none, 30 frames of probation']

    State that the operator kept but did not declare has a line of its own.
    """
    cut = f"after frame {result.seq}" if result.hot else "by stopping and starting"
    words = [
        f"{result.node}: swapped {cut}",
        f"paused for {result.gap_ms:.1f} ms",
        *(f"left out {count} of {name}" for name, count in result.left_out.items() if count),
        f"state {result.state}",
        f"{result.proven_frames} frames of probation",
    ]
    warnings = [f"{result.node}: {lost_words(result.forgotten)}"] if result.forgotten else []
    if shadow and not result.hot:
        warnings.append("shadow: none: a swap by stopping and starting compares nothing")
    return [", ".join(words), *warnings, *_shadow_lines(result.shadow)]


def _shadow_lines(shadow: ShadowReport | None) -> list[str]:
    if shadow is None:
        return []
    apart = [
        f"{name} in {d.frames} by up to {d.most:.3g}" for name, d in shadow.differences.items()
    ]
    line = (
        f"shadow: {shadow.frames} frames, {shadow.identical} answered alike, "
        f"{shadow.handler_ms:.1f} ms each" + (f", {shadow.missed} missed" if shadow.missed else "")
    )
    return [f"{line}; different: {', '.join(apart)}" if apart else line]
