"""The systemd unit of an agent."""

import sys
from pathlib import Path

UNIT = """\
[Unit]
Description=fovea agent
Wants=network-online.target
After=network-online.target

[Service]
Type=exec
ExecStart={command} agent --config {config}
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


def agent_unit(config: Path, state: Path, user: str = "fovea") -> str:
    """The unit for an agent with that file, which keeps its state there."""
    config = config.resolve()
    command = Path(sys.executable).parent / "fovea"
    return UNIT.format(
        command=command, config=config, folder=config.parent, state=state.resolve(), user=user
    )
