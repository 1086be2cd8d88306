"""The rows of a table: what is asked for -> a case for each strategy, budget and change."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

from bench.tracking.budgets import PLANNED, PURSUIT
from bench.tracking.episode import Rules
from bench.tracking.options import Options
from drivers.simulated.strategies import WITH_ROI

ROI_ALONE = ", ROI alone"  # in the name of a row whose tracker does not see the context
ROI_COORDINATES = ", ROI coordinates"  # of one whose tracker's state moves with the ROI
NO_CUE = ", no cue"  # of one whose tracker hears no policy
LONG = ", long"  # of one with a single start, followed to the end of the clip
# what the tracker sees (context, coordinates of the ROI), by `--sees`
SEES = {
    "both": ((True, False),),
    "roi": ((False, False),),
    "coordinates": ((False, True),),
    "each": ((True, False), (False, False)),
    "all": ((True, False), (False, False), (False, True)),
}
CUES = {"reference": (True,), "none": (False,), "each": (True, False)}
PROTOCOLS = {"short": (False,), "long": (True,), "both": (False, True)}


@dataclass(frozen=True, kw_only=True)
class Case:
    """One row of a table: a strategy at a budget, and what was changed about it."""

    strategy: str
    budget: str  # a fraction
    name: str  # in the table
    rules: Rules
    replaced: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()  # of the graph, as --set takes them
    tracker: str = ""  # as --tracker takes it; empty: the class that the graph names
    policy: str = ""  # a name of `POLICIES`, a file, or empty: the class that the graph names

    @property
    def parts(self) -> tuple[tuple[str, ...], str, str]:
        """Changes, tracker and policy, as `planned` takes them."""
        return self.changes, self.tracker, self.policy


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """What all cases have in common."""

    graph: str
    frames: tuple[int, int]  # first and last, counted from 1
    kinds: tuple[str, ...]
    every: int = 8  # frames between starts
    players: int = 1
    seed: int = 0


def cases(options: Options) -> list[Case]:
    """Return a case for each row asked for; without a plan one per budget, of `full` one in all.

    A cue comes from the context of a budget: with one, `full` has a row for each of them, too.
    """
    rules = rules_of(options)
    found: list[Case] = []
    for strategy, budget in product(options.strategies, options.budgets):
        if strategy == "foveated":
            found += _planned(options, str(budget), rules)
        elif strategy == PURSUIT:
            told = replace(options, policy={"": PURSUIT}, replace=())
            own = _planned(told, str(budget), rules)
            found += [replace(c, name=c.name.replace("foveated", PURSUIT, 1)) for c in own]
        elif strategy == "full":
            cued = [rule for rule in rules if rule.cue]
            found += _plain(strategy, str(budget), cued, options.changes)
            if budget == options.budgets[0]:
                found += _plain(strategy, "1", [r for r in rules if not r.cue], options.changes)
        else:
            found += _plain(strategy, str(budget), rules, options.changes)
    return [replace(case, tracker=options.tracker) for case in found]


def _planned(options: Options, budget: str, rules: Sequence[Rules]) -> list[Case]:
    """Return the policy's cases: one for each file, rule and set of parts known from the truth."""
    found = []
    for (label, path), rule, parts in product(
        options.policy.items(), rules, [(), *options.replace]
    ):
        name = "foveated" + (f" {label}" if label else "")
        name += f" + true {' and '.join(parts)}" if parts else ""
        case = Case(
            strategy="foveated",
            budget=budget,
            name=name + suffix(rule, late=_several(rules)),
            rules=rule,
            replaced=parts,
            changes=options.changes,
            policy=path,
        )
        found.append(case)
    return found


def _plain(
    strategy: str, budget: str, rules: Sequence[Rules], changes: tuple[str, ...]
) -> list[Case]:
    """Return cases of a strategy without a network: one for each rule that it differs by."""
    policy = "round_robin" if strategy == "round_robin" else PURSUIT  # they need no network
    kept = dict.fromkeys(_own(strategy, rule) for rule in rules)
    return [
        Case(
            strategy=strategy,
            budget=budget,
            name=strategy + suffix(rule, late=strategy in PLANNED and _several(rules)),
            rules=rule,
            changes=changes,
            policy=policy,
        )
        for rule in kept
    ]


def _own(strategy: str, rule: Rules) -> Rules:
    """Return a rule as a strategy has it: late plans only where there are plans."""
    looks = strategy in WITH_ROI
    own = replace(rule, context=rule.context or not looks, local=rule.local and looks)
    if strategy in PLANNED:
        return own
    plain = Rules()
    return replace(own, delay=plain.delay, replan=plain.replan, prediction=plain.prediction)


def _several(rules: Sequence[Rules]) -> bool:
    """Whether rows must name their delay and Ta."""
    return len({(rule.delay, rule.replan) for rule in rules}) > 1


def rules_of(options: Options) -> list[Rules]:
    """Return all combinations of protocol, delay, interval, prediction, view and cue.

    A tracker whose state is in coordinates of the ROI is the paper's, which has no cue; its
    strategies without a ROI are then measured without one, too. A cue comes as late as the plans.
    """
    foreseen = {"kalman": (True,), "hold": (False,), "both": (True, False)}[options.prediction]
    found = [
        Rules(
            delay=d, replan=ta, prediction=p, context=context, local=local,
            cue=cue and not local, cue_delay=d if cue and not local else 0, to_end=to_end,
            longest=options.longest,
        )
        for to_end, d, ta, p, (context, local), cue in product(
            PROTOCOLS[options.protocol], options.delay, options.replan, foreseen,
            SEES[options.sees], CUES[options.cue],
        )
    ]  # fmt: skip
    return list(dict.fromkeys(found))


def suffix(rule: Rules, *, late: bool) -> str:
    """Return the end of a row's name, after its strategy."""
    name = ""
    if late or rule.delay or rule.replan != 1:
        name = f", delay {rule.delay}, Ta {rule.replan}"
    name += "" if rule.prediction else ", no prediction"
    name += ROI_COORDINATES if rule.local else "" if rule.context else ROI_ALONE
    name += "" if rule.cue or rule.local else NO_CUE
    return name + (LONG if rule.to_end else "")
