"""Training of the policy on roll-outs of itself.

It records procedural clips, then alternates two steps: the policy, sampling its choices, follows
targets through the clips; the network learns from its inputs and the utility of each choice. Only
the first round, a sixth of the iterations, is driven by a teacher that knows the truth, because an
untrained network would reach only useless situations. In later rounds, every situation, with its
missing views, is caused by the policy itself.

The loss is the negative expected utility, the sum over steps and objects of p U, which fits every
task (labels are the case of a one-hot U), plus a share of the cross-entropy to softmax(U /
temperature): where p is close to 0, the expected utility alone has no gradient.
"""

# mypy: disallow-untyped-decorators=False
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from operators.policy.data import TRAIN_SEEDS, VALIDATION_SEEDS, Recording, made_with, record
from operators.policy.decision import Rules, Selection
from operators.policy.model import INPUTS, PolicyNet
from operators.policy.network import softmax
from operators.policy.pool import Pool
from operators.policy.rollout import Choose, Episode, roll, tasks, teacher
from operators.policy.tokens import Array, Objects, batched
from operators.policy.training_settings import TrainSettings
from operators.training.checkpoint import Progress, left, path_in
from operators.training.device import device_of, moved
from operators.training.folder import open_folder
from operators.training.identity import of_settings
from operators.training.log import EVERY, note, shorten
from operators.training.progress import Phases, bar
from operators.training.schedule import warmed_cosine
from pipeline.errors import RunError, SettingsError

ROUNDS = 6
CLIPS, TRAIN, SCORE = "record clips", "train", "score"
PHASES = Phases(CLIPS, TRAIN, SCORE)


def loss_of(
    logits: Tensor, worth: Tensor, mask: Tensor, settings: TrainSettings
) -> tuple[Tensor, Tensor]:
    """Return loss and expected utility of a step; logits and worth are (B, N, Tp)."""
    chance = logits.softmax(1)
    gained = (chance * worth).sum(1)
    wanted = (worth / settings.temperature).masked_fill(~mask[..., None], -1e4).softmax(1)
    counts = (worth.amax(1) > 0).float()  # steps with any utility
    steps = counts.sum().clamp(min=1)
    imitation = -(wanted * logits.log_softmax(1)).sum(1)
    utility = (gained * counts).sum() / steps
    return settings.imitation * (imitation * counts).sum() / steps - utility, utility


def network_choice(net: PolicyNet) -> Choose:
    """Return the network as the policy of roll-outs, for many moments at once."""
    device = next(net.parameters()).device

    def choose(moments: Sequence[Objects], conditions: Sequence[Array]) -> Sequence[Array]:
        net.eval()
        given = batched(moments, conditions)
        with torch.no_grad():
            answer = net(
                *(moved(torch.from_numpy(np.asarray(given[name])), device) for name in INPUTS)
            )
        logits = answer.cpu().numpy()
        return [softmax(one[: len(m.ids)]) for one, m in zip(logits, moments, strict=True)]

    return choose


class Run(Progress):
    """A training: network, optimiser, and the policy of this round's roll-outs."""

    def __init__(self, settings: TrainSettings, net: PolicyNet) -> None:
        self.device = device_of(settings.device)
        self.settings, self.net = settings, net
        self.net.to(self.device)
        self.roller = PolicyNet(**net.sides, use=net.use).to(self.device)
        self.hand_over()
        self.optimiser = torch.optim.AdamW(
            net.parameters(), lr=settings.rate, weight_decay=settings.decay
        )
        parts = {"net": self.net, "roller": self.roller, "optimiser": self.optimiser}
        super().__init__(settings.out, parts, identity_of(settings))

    def hand_over(self) -> None:
        """Use a copy of the current network for roll-outs from now on."""
        self.roller.load_state_dict(self.net.state_dict())


@dataclass
class Clips:
    """Recordings, and episodes on them."""

    recordings: Sequence[Recording]
    rules: Rules
    settings: TrainSettings

    def episodes(self, count: int, *, seed: int, plain: bool = False) -> list[Episode]:
        """Return new episodes; `plain`: prompted by a box, replanned every frame, no delay."""
        late = None if plain else self.settings.late
        found = tasks(self.recordings, count, frames=self.settings.length, seed=seed, late=late)
        utility = self.settings.utility
        return [Episode(self.recordings[t.clip], t, self.rules, utility) for t in found]


def round_of(run: Run, clips: Clips, number: int) -> Pool:
    """Return the samples of one round of roll-outs; deterministic for seed, round and policy."""
    s = run.settings
    rng = np.random.default_rng([s.seed, number])
    episodes = clips.episodes(s.episodes, seed=1000 * s.seed + number)
    choose = network_choice(run.roller) if number else teacher(episodes, 0.2, rng)
    how: Selection = "sample" if number else "argmax"
    samples = roll(episodes, choose, frames=s.length, how=how, rng=rng)
    if not samples:
        raise RunError(
            f"round {number}: expected moments in which a choice is worth something, got none; "
            "does the detector find anything, and are clips and episodes long enough?"
        )
    return Pool(samples, run.device)


def coverage(net: PolicyNet, clips: Clips, *, count: int, seed: int) -> dict[str, float]:
    """Return the share of the target that the ROI shows under the policy, by label."""
    episodes = clips.episodes(count, seed=seed, plain=True)
    rng = np.random.default_rng(seed)
    roll(episodes, network_choice(net), frames=clips.settings.length, how="argmax", rng=rng, keep=0)
    shown: dict[str, list[float]] = {}
    for episode in episodes:
        shown.setdefault(episode.label, []).extend(episode.shown[1:])
    # an episode may end with its clip, before the policy's first choice takes effect
    judged = {label: values for label, values in sorted(shown.items()) if values}
    return {label: round(float(np.mean(values)), 4) for label, values in judged.items()}


def train(settings: TrainSettings, *, say: Callable[[str], None] = print) -> PolicyNet:
    """Record missing clips, train the remaining steps, write checkpoint and log."""
    torch.set_num_threads(settings.threads)
    open_folder(settings.out)
    device_of(settings.device)  # fail before the recording, not after it
    left(path_in(settings.out), identity_of(settings))  # fail early, too
    began = time.monotonic()
    learn, check = recorded(settings, say)
    sides = learn.recordings[0].sides
    clips_s = time.monotonic() - began
    torch.manual_seed(settings.seed)
    run = Run(settings, PolicyNet(**sides, use=settings.use))
    run.resume()
    log = settings.out / "log.csv"
    shorten(log, run.step)
    began = time.monotonic() - run.elapsed_s
    per_round = math.ceil(settings.iterations / ROUNDS)
    with bar(PHASES[TRAIN], settings.iterations, run.step) as shown:
        while run.step < settings.iterations:
            number = run.step // per_round
            pool = round_of(run, learn, number)
            while run.step < min(settings.iterations, (number + 1) * per_round):
                loss, gained = advance(run, pool)
                run.elapsed_s = time.monotonic() - began
                if run.step % EVERY == 0:
                    note(log, run.step, run.elapsed_s, {"loss": loss, "utility": gained})
                shown.step(f"round {number} loss {loss:.3f} utility {gained:.3f}")
                if run.step % per_round:  # at the end of a round it is saved with the new roller
                    run.save_when_due()
            run.hand_over()
            run.save()
            del pool  # free it before the next one
            say(f"round {number}: {json.dumps(coverage(run.net, check, count=48, seed=7))}")
    with bar(PHASES[SCORE], 1) as shown:
        covered = coverage(run.net, check, count=160, seed=8)
        shown.step()
    facts = {
        "clips_s": round(clips_s),
        "train_s": round(run.elapsed_s),
        "coverage": covered,
    }
    (settings.out / "result.json").write_text(json.dumps(facts, indent=1) + "\n")
    say(json.dumps(facts))
    plot(log, settings.out / "training.png")
    return run.net


def identity_of(settings: TrainSettings) -> dict[str, str]:
    """Return what determines the network; raises `SettingsError` for plans that come too late."""
    made = made_with(settings.frames, settings.changes)
    reach, latest = int(made["association.horizon"]), max(settings.late.delays)
    if latest >= reach:
        raise SettingsError(
            f"delays: plans reach {reach} frames, those {latest} frames late are over before they "
            "hold; give others, or another association.horizon"
        )
    return of_settings(settings, "changes") | made


def recorded(settings: TrainSettings, say: Callable[[str], None]) -> tuple[Clips, Clips]:
    """Return training clips and validation clips."""
    groups = []
    asked = (
        (PHASES[CLIPS], TRAIN_SEEDS, settings.clips),
        (f"{PHASES[CLIPS]} to check on", VALIDATION_SEEDS, settings.validation),
    )
    for name, first, count in asked:
        seeds = range(first, first + count)
        paths = record(
            seeds,
            settings.frames,
            settings.data,
            workers=settings.threads,
            changes=settings.changes,
            say=say,
            name=name,
        )
        recordings = [Recording(path) for path in paths]
        # without the prior: the network has to learn what the prior would correct
        rules = Rules(roi_channels=recordings[0].sides["roi_channels"], target_prior=1)
        groups.append(Clips(recordings=recordings, rules=rules, settings=settings))
    return groups[0], groups[1]


def advance(run: Run, pool: Pool) -> tuple[float, float]:
    """One step of the optimiser: loss and expected utility."""
    s = run.settings
    rng = np.random.default_rng([s.seed, 11, run.step])
    given = pool.batch(rng.integers(len(pool), size=s.batch))
    rise = max(1, round(s.warmup * s.iterations))
    for group in run.optimiser.param_groups:
        group["lr"] = warmed_cosine(
            run.step, peak=s.rate, warmup=rise, steps=s.iterations, lowest=0.0
        )
    run.net.train()
    logits = run.net(*(given[name] for name in INPUTS))
    loss, gained = loss_of(logits, given["worth"], given["mask"], s)
    run.optimiser.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), 1.0)
    run.optimiser.step()
    run.step += 1
    return float(loss.detach()), float(gained.detach())


def plot(log: Path, picture: Path) -> None:
    """Loss and expected utility over the iterations."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    if not log.exists():
        return
    rows = np.loadtxt(log, delimiter=",", ndmin=2, skiprows=1)
    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3), layout="constrained")
    for place, column, name in ((axes[0], 2, "loss"), (axes[1], 3, "expected utility")):
        place.plot(rows[:, 0], rows[:, column])
        place.set(xlabel="iteration", title=name)
    figure.savefig(picture, dpi=120)
    pyplot.close(figure)
