"""Where the reports of each bench stand in RESULTS.md: name of a bench -> section, order, title."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Place:
    """The place of a bench's report in the page."""

    section: str
    order: int
    title: str


PLACES = {
    "loop": Place(section="Time and transport", order=2, title="The loop"),
    "bus": Place(section="Time and transport", order=4, title="One hop"),
    "watching": Place(section="Time and transport", order=3, title="What watching costs"),
    "usb": Place(
        section="Time and transport", order=5,
        title="The paper's two streams over the USB driver and through the graph",
    ),
    "usb_reads": Place(section="Time and transport", order=6, title="USB reads in flight"),
    "genicam": Place(
        section="Time and transport", order=7, title="How fast an industrial camera is aimed"
    ),
    "sensors": Place(
        section="Time and transport", order=8, title="Kinds of sensor that keep the contract"
    ),
    "objects": Place(section="Time of each part", order=9, title="The running graph, by objects"),
    "raw": Place(section="Time of each part", order=10, title="Raw frames to RGB"),
    "whole_pitch": Place(
        section="Time of each part", order=11, title="The whole pitch, drawn where a sensor looks"
    ),
    "raw_loss": Place(
        section="Networks and scenes", order=12, title="The detector on raw frames with noise"
    ),
    "prototype": Place(section="Late plans", order=20, title="The 200-megapixel prototype"),
    "prototype_detector": Place(
        section="Late plans", order=20, title="Ways to look at the prototype's context"
    ),
    "long_horizon": Place(
        section="Late plans", order=21, title="Plans of 200 frames: the network beside rules"
    ),
    "providers": Place(
        section="Time of each part", order=40, title="Networks on ONNX Runtime's providers"
    ),
    "many": Place(
        section="Tracking under a pixel budget", order=34,
        title="Tracks of people and of the ball with and without colours: means over clips",
    ),
    "consumer_gain": Place(
        section="Tracking under a pixel budget", order=33,
        title="What a window gains the tracker, by the target's distance from its middle",
    ),
    "identity_gain": Place(
        section="Tracking under a pixel budget", order=35,
        title="What a look at somebody gains the identities, by its kind",
    ),
    "trackers": Place(
        section="Tracking under a pixel budget", order=29,
        title="The consumer alone: trackers started on the true box, beside each other",
    ),
    "rois": Place(
        section="Tracking under a pixel budget", order=30,
        title="One large ROI against two and four small ones at equal pixels",
    ),
    "rules": Place(
        section="Tracking under a pixel budget", order=31,
        title="Each rule of the policies left out once",
    ),
    "policies": Place(
        section="Tracking under a pixel budget", order=32,
        title="The learned policy beside the rule pursuit, one target",
    ),
    "real_time": Place(
        section="Tracking under a pixel budget", order=32,
        title="Variants of a graph in real time, one target",
    ),
    "second_look": Place(
        section="Tracking under a pixel budget", order=33,
        title="A ball rated above another candidate, by context, and by detector and encoder",
    ),
    "referee_looks": Place(
        section="Networks and scenes", order=13,
        title="Referees told by the context, by their kits, and by a look at full resolution",
    ),
    "match_kits": Place(
        section="Networks and scenes", order=13,
        title="Referees of matches that no detector saw, by a look and by kits of the match",
    ),
    "rules_from_starts": Place(
        section="Tracking under a pixel budget", order=32,
        title="Each rule of the policies left out once, prompted by the true box from many starts",
    ),
    "reading": Place(
        section="Reading under a pixel budget", order=1,
        title="Texts of a street that a frozen reader transcribes, by strategy and budget",
    ),
    "shirts": Place(
        section="Reading under a pixel budget", order=2,
        title="Players of a whole pitch named by their shirts, read at all (alone), and names kept",
    ),
    "shirts_stages": Place(
        section="Reading under a pixel budget", order=3,
        title="Where a shirt number is lost on the way to a reader",
    ),
    "manipulation": Place(
        section="Manipulation under a pixel budget", order=1,
        title="A robot's insertion by a frozen consumer, by strategy and budget",
    ),
    "crash": Place(section="Faults, swaps and long runs", order=1, title="SIGKILL under load"),
    "chaos": Place(section="Faults, swaps and long runs", order=3, title="Random faults"),
    "swap": Place(section="Faults, swaps and long runs", order=5, title="Swaps"),
    "endure": Place(section="Faults, swaps and long runs", order=6, title="Many kills and swaps"),
    "soak": Place(section="Faults, swaps and long runs", order=7, title="An hour of the demo"),
    "follow": Place(
        section="Faults, swaps and long runs", order=8,
        title="The target changed every minute: IoU, share in the ROI, share answered",
    ),
    "usb_failures": Place(
        section="Faults, swaps and long runs", order=9, title="Failures of the USB link"
    ),
    "detector": Place(
        section="Networks and scenes", order=10,
        title="A general detector on labelled pictures, each shrunk to the context's size",
    ),
    "detector_versions": Place(
        section="Networks and scenes", order=11,
        title="Versions of the detector and of its input, by match and scale",
    ),
    "kits": Place(
        section="Networks and scenes", order=13,
        title="Players and referees by the detector alone, and with kits",
    ),
    "people_missed": Place(
        section="Networks and scenes", order=12,
        title="People missed in the context, by how much of them another person covers",
    ),
    "roi_balls": Place(
        section="Networks and scenes", order=14,
        title="The ball rated best of what a ROI shows, and above false finds of other ROIs",
    ),
    "fuzz": Place(
        section="Several hosts and security", order=5,
        title="Generated input: graph files, orders, bytes",
    ),
    "other_user": Place(section="Several hosts and security", order=7, title="Another user"),
    "tuned": Place(section="Time and transport", order=4, title="What `fovea tune` changes"),
    "replays": Place(
        section="Time and transport", order=6,
        title="Recorded and replayed, bit for bit; and other settings on the same light",
    ),
    "recording": Place(
        section="Time and transport", order=6,
        title="Recording the prototype's two streams, and recorders that are killed",
    ),
    "fleet_growth": Place(
        section="Several hosts and security", order=8,
        title="How a deployment grows with its hosts, all of them on one machine",
    ),
}  # fmt: skip
ELSEWHERE = Place(section="Time and transport", order=99, title="")
