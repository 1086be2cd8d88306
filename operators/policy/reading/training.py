"""Training of the policy that reads, on roll-outs of itself.

As `training_run.py` trains the one that follows: a teacher drives the first of the rounds, the
network's own draws the others. The loss is the negative expected number of texts that the plan
reads (utility.py), as a share of what the greedy plan that knows the truth reads, plus a
share of the cross-entropy to what each candidate adds to that plan.
"""

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from operators.policy.data import Recording, made_with, record
from operators.policy.decision import Selection
from operators.policy.network import softmax
from operators.policy.reading.model import INPUTS, ReadingNet
from operators.policy.reading.rollout import SURE, Choose, Episode, Sample, roll, tasks, teacher
from operators.policy.reading.settings import (
    GRAPH,
    TRAIN_SEEDS,
    VALIDATION_SEEDS,
    ReadingTrainSettings,
)
from operators.policy.reading.street import Street
from operators.policy.reading.tokens import DEAF, Texts, batched
from operators.policy.reading.utility import DISCOUNT
from operators.policy.tokens import Array
from operators.policy.training_run import plot
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
LEAST_WORTH = 0.02  # texts: steps at which nothing adds more are not imitated


def read_by(chance: Tensor, reads: Tensor, left: Tensor) -> Tensor:
    """Return the expected utility of plans: (B, N, Tp), (B, N, J, Tp), (B, J) -> (B,), texts."""
    read = (chance[:, :, None] * reads).sum(1).clamp(max=1)  # (B, J, Tp), given it was not yet
    unread = torch.cumprod(1 - read + 1e-9, -1)
    before = torch.cat([torch.ones_like(unread[..., :1]), unread[..., :-1]], -1)
    discount = DISCOUNT ** torch.arange(reads.shape[-1], device=reads.device)
    return (left[..., None] * before * read * discount).sum((1, 2))


def loss_of(
    logits: Tensor, given: Mapping[str, Tensor], settings: ReadingTrainSettings
) -> tuple[Tensor, Tensor]:
    """Return loss and utility of a step: logits (B, N, Tp) and what `batch_of` returns.

    The utility is the mean share of what the greedy plan reads.
    """
    reads, left, worth = given["reads"], given["left"], given["worth"]
    best = torch.nn.functional.one_hot(worth.argmax(1), worth.shape[1]).transpose(1, 2)
    possible = read_by(best.to(reads.dtype), reads, left).clamp(min=LEAST_WORTH)
    utility = (read_by(logits.softmax(1), reads, left) / possible).mean()
    wanted = (worth / settings.temperature).masked_fill(~given["mask"][..., None], -1e4).softmax(1)
    counts = (worth.amax(1) > LEAST_WORTH).float()
    imitation = -(wanted * logits.log_softmax(1)).sum(1)
    imitated = (imitation * counts).sum() / counts.sum().clamp(min=1)
    return settings.imitation * imitated - utility, utility


def network_choice(net: ReadingNet) -> Choose:
    """Return the network as the policy of roll-outs, for many moments at once."""
    device = next(net.parameters()).device

    def choose(moments: Sequence[Texts], conditions: Sequence[Array]) -> Sequence[Array]:
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

    def __init__(self, settings: ReadingTrainSettings, net: ReadingNet) -> None:
        self.device = device_of(settings.device)
        self.settings, self.net = settings, net
        self.net.to(self.device)
        self.roller = ReadingNet(**net.sides, use=net.use).to(self.device)
        self.hand_over()
        self.optimiser = torch.optim.AdamW(
            net.parameters(), lr=settings.rate, weight_decay=settings.decay
        )
        parts = {"net": self.net, "roller": self.roller, "optimiser": self.optimiser}
        super().__init__(settings.out, parts, identity_of(settings))

    def hand_over(self) -> None:
        """Use a copy of the current network for roll-outs from now on."""
        self.roller.load_state_dict(self.net.state_dict())


def episodes_of(
    streets: Sequence[Street], s: ReadingTrainSettings, count: int, seed: int, *, plain: bool
) -> list[Episode]:
    """Return new episodes; `plain`: replanned every frame, no delay."""
    late = None if plain else s.late
    found = tasks(streets, count, frames=s.length, seed=seed, late=late)
    channels = streets[0].recording.sides["roi_channels"]
    sure = SURE if "feedback" in s.use else DEAF
    return [Episode(streets[t.clip], t, channels, sure) for t in found]


def round_of(run: Run, streets: Sequence[Street], number: int) -> list[Sample]:
    """Return the samples of one round; deterministic for seed, round and policy."""
    s = run.settings
    rng = np.random.default_rng([s.seed, number])
    episodes = episodes_of(streets, s, s.episodes, 1000 * s.seed + number, plain=False)
    choose = network_choice(run.roller) if number else teacher(episodes, 0.2, rng)
    how: Selection = "sample" if number else "argmax"
    samples = roll(episodes, choose, frames=s.length, how=how, rng=rng, keep=s.keep)
    if not samples:
        raise RunError(
            f"round {number}: expected moments in which something can be read, got none; "
            "has the scene texts, and are clips and episodes long enough?"
        )
    return samples


def figures(episodes: Sequence[Episode]) -> dict[str, float]:
    """Return shares of the texts legible in the episodes: shown at a readable size, and read."""
    shown, read, count = 0, 0, 0
    for episode in episodes:
        frames = slice(episode.task.start, episode.frame)
        street = episode.street
        able = street.legible[frames].any(0)
        count += int(able.sum())
        shown += int((episode.reader.shown_at >= 0)[able].sum())
        read += int(episode.reader.read[able].sum())
    return {
        "texts": count,
        "shown": round(shown / max(count, 1), 4),
        "read": round(read / max(count, 1), 4),
    }


def score(
    net: ReadingNet, streets: Sequence[Street], s: ReadingTrainSettings, *, seed: int
) -> dict[str, float]:
    """Return what the policy shows and reads, replanned every frame, without delay."""
    episodes = episodes_of(streets, s, s.checks, seed, plain=True)
    rng = np.random.default_rng(seed)
    roll(episodes, network_choice(net), frames=s.length, how="argmax", rng=rng, keep=0)
    return figures(episodes)


def train(settings: ReadingTrainSettings, *, say: Callable[[str], None] = print) -> ReadingNet:
    """Record missing clips, train the remaining steps, write checkpoint and log."""
    torch.set_num_threads(settings.threads)
    open_folder(settings.out)
    device_of(settings.device)  # fail before the recording, not after it
    left(path_in(settings.out), identity_of(settings))  # fail early, too
    began = time.monotonic()
    learn, check = recorded(settings, say)
    clips_s = time.monotonic() - began
    torch.manual_seed(settings.seed)
    run = Run(settings, ReadingNet(**learn[0].recording.sides, use=settings.use))
    run.resume()
    log = settings.out / "log.csv"
    shorten(log, run.step)
    began = time.monotonic() - run.elapsed_s
    per_round = math.ceil(settings.iterations / ROUNDS)
    with bar(PHASES[TRAIN], settings.iterations, run.step) as shown:
        while run.step < settings.iterations:
            number = run.step // per_round
            samples = round_of(run, learn, number)
            while run.step < min(settings.iterations, (number + 1) * per_round):
                loss, gained = advance(run, samples)
                run.elapsed_s = time.monotonic() - began
                if run.step % EVERY == 0:
                    note(log, run.step, run.elapsed_s, {"loss": loss, "utility": gained})
                shown.step(f"round {number} loss {loss:.3f} utility {gained:.3f}")
                if run.step % per_round:  # at the end of a round it is saved with the new roller
                    run.save_when_due()
            run.hand_over()
            run.save()
            told = score(run.net, check, settings, seed=7)
            say(f"round {number}: {json.dumps(told)}")
    with bar(PHASES[SCORE], 1) as shown:
        found = score(run.net, check, settings, seed=8)
        shown.step()
    facts = {"clips_s": round(clips_s), "train_s": round(run.elapsed_s), **found}
    (settings.out / "result.json").write_text(json.dumps(facts, indent=1) + "\n")
    say(json.dumps(facts))
    plot(log, settings.out / "training.png")
    return run.net


def identity_of(settings: ReadingTrainSettings) -> dict[str, str]:
    """Return what determines the network; raises `SettingsError` for plans that come too late."""
    made = made_with(settings.frames, settings.changes, GRAPH)
    reach, latest = int(made["association.horizon"]), max(settings.late.delays)
    if latest >= reach:
        raise SettingsError(
            f"delays: plans reach {reach} frames, those {latest} frames late are over before they "
            "hold; give others, or another association.horizon"
        )
    return of_settings(settings, "changes") | made


def recorded(
    settings: ReadingTrainSettings, say: Callable[[str], None]
) -> tuple[list[Street], list[Street]]:
    """Return training clips and validation clips."""
    groups = []
    asked = (
        (PHASES[CLIPS], TRAIN_SEEDS, settings.clips),
        (f"{PHASES[CLIPS]} to check on", VALIDATION_SEEDS, settings.validation),
    )
    for name, first, count in asked:
        paths = record(
            range(first, first + count),
            settings.frames,
            settings.data,
            workers=settings.threads,
            changes=settings.changes,
            say=say,
            name=name,
            graph=GRAPH,
        )
        recordings = [Recording(path) for path in paths]
        groups.append([Street(each, scale) for scale in settings.scales for each in recordings])
    return groups[0], groups[1]


def batch_of(
    samples: Sequence[Sample], rows: Sequence[int], device: torch.device
) -> dict[str, Tensor]:
    """Return samples as the network's inputs, padded to the longest, and what they are worth."""
    chosen = [samples[row] for row in rows]
    given = batched([s.candidates for s in chosen], [s.condition for s in chosen])
    steps, texts = chosen[0].reads.shape[2], max(s.reads.shape[1] for s in chosen)
    reads = np.zeros((*given["mask"].shape, texts, steps), np.float32)
    worth = np.zeros((*given["mask"].shape, steps), np.float32)
    left = np.zeros((len(chosen), texts), np.float32)
    for row, sample in enumerate(chosen):
        count, some = sample.reads.shape[:2]
        reads[row, :count, :some], worth[row, :count] = sample.reads, sample.worth
        left[row, :some] = sample.left
    arrays = {**given, "reads": reads, "left": left, "worth": worth}
    return {name: moved(torch.from_numpy(values), device) for name, values in arrays.items()}


def advance(run: Run, samples: Sequence[Sample]) -> tuple[float, float]:
    """One step of the optimiser: loss and expected utility."""
    s = run.settings
    rng = np.random.default_rng([s.seed, 11, run.step])
    given = batch_of(samples, rng.integers(len(samples), size=s.batch).tolist(), run.device)
    rise = max(1, round(s.warmup * s.iterations))
    for group in run.optimiser.param_groups:
        group["lr"] = warmed_cosine(
            run.step, peak=s.rate, warmup=rise, steps=s.iterations, lowest=0.0
        )
    run.net.train()
    logits = run.net(*(given[name] for name in INPUTS))
    loss, gained = loss_of(logits, given, s)
    run.optimiser.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(run.net.parameters(), 1.0)
    run.optimiser.step()
    run.step += 1
    return float(loss.detach()), float(gained.detach())
