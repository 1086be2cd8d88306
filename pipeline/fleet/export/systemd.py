"""`fovea export systemd`: write units for a graph's agents, and one that deploys."""

import getpass
import sys
from collections.abc import Sequence
from pathlib import Path

from pipeline.fleet.export.bundle import ETC, Bundle, comments
from pipeline.graph.plan import Plan

UNIT = """\
[Unit]
Description=fovea agent
Wants=network-online.target
After=network-online.target

[Service]
Type=exec
ExecStart={command}
WorkingDirectory={folder}
Restart=always
RestartSec=1
# its nodes are in the same group and end with it; what ran goes on at the next start
KillMode=mixed
TimeoutStopSec=30
User={user}
NoNewPrivileges=yes
ProtectSystem=strict
ProtectHome=read-only
# run folders lie in /tmp, which has to be the one that `fovea ps` on this host looks into
ReadWritePaths=/tmp /dev/shm {state}
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
LimitNOFILE=65536
LimitMEMLOCK=infinity

[Install]
WantedBy=multi-user.target
"""


def agent_unit(config: Path, state: Path, user: str = "fovea", *, told: bool = False) -> str:
    """Return the unit for an agent with that configuration and state folder.

    `told`: the folder is an option of the agent and not what its file says.
    """
    config, state = config.resolve(), state.resolve()
    words = ["agent", "--config", str(config), *(["--state", str(state)] if told else [])]
    return UNIT.format(
        command=_command(words), folder=_percent(str(config.parent)),
        state=_listed(str(state)), user=user,
    )  # fmt: skip


def systemd(plan: Plan, bundle: Bundle) -> str:
    """Return units: one per host, to be copied there, and one that deploys from this host."""
    if not plan.hosts:
        return _titled(f"fovea-{plan.name}.service", _unit(["run", str(bundle.graph)], plan.name))
    units = [
        _titled(
            f"{label}: fovea-agent.service; {bundle.host_folder(label)} is to be {ETC} there, of "
            "the user fovea",
            agent_unit(Path(f"{ETC}/agent.yaml"), Path(f"{ETC}/state")),
        )
        for label in plan.hosts
    ]
    deploy = ["up", str(bundle.graph), "--credentials", str(bundle.own), "--replace"]
    unit = _unit(deploy, plan.name, once=True)
    return "\n".join([*units, _titled(f"here: fovea-{plan.name}.service (once)", unit)])


def _unit(words: Sequence[str], what: str, *, once: bool = False) -> str:
    """Return a unit of this user in the current folder, where the user's operators may be."""
    return (
        f"[Unit]\nDescription=fovea {what}\nWants=network-online.target\n"
        "After=network-online.target\n\n"
        f"[Service]\nType={'oneshot' if once else 'exec'}\nExecStart={_command(words)}\n"
        f"WorkingDirectory={_percent(str(Path.cwd()))}\nUser={getpass.getuser()}\n"
        f"Restart={'on-failure' if once else 'always'}\nRestartSec=2\n"
        "KillMode=mixed\nTimeoutStopSec=30\nNoNewPrivileges=yes\nLimitNOFILE=65536\n\n"
        "[Install]\nWantedBy=multi-user.target\n"
    )


def _command(words: Sequence[str]) -> str:
    """Return the line that runs `fovea` with these words; there, and only there, $ is special."""
    words = [str(Path(sys.executable).parent / "fovea"), *words]
    return " ".join(_listed(word).replace("$", "$$") for word in words)


def _listed(word: str) -> str:
    """Quote a word of a list for systemd.

    >>> _listed("up"), _listed("my graph.yaml"), _listed("100%")
    ('up', '"my graph.yaml"', '100%%')
    """
    word = _percent(word.replace("\\", "\\\\").replace('"', '\\"'))
    return f'"{word}"' if any(mark in word for mark in " '\"\t\\") else word


def _percent(path: str) -> str:
    """Return a path that is all of a value, so that it needs no quotes."""
    return path.replace("%", "%%")


def _titled(title: str, text: str) -> str:
    return "".join(comments(title)) + text
