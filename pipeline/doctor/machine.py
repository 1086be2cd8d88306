"""Check the machine: shared memory, locks, open files, cores, governor, clocks, ports."""

import ctypes
import fcntl
import os
import resource
import struct
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

from pipeline.bus.network import AGENT_PORT, NODE_PORTS
from pipeline.cores import available_cores
from pipeline.doctor.finding import Finding, ok, warning, wrong
from pipeline.run.memory_folder import MEMORY

NODE = "pipeline.node.process"
LEAST_SHARED_MB = 64.0  # a container's default, barely enough for a graph
LEAST_DISK_MB = 100.0
LEAST_FILES = 256
COARSEST_NS = 1000  # resolution of the monotonic clock
SYS = Path("/sys/devices/system")
GOOD_CLOCKS = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page", "xen")
TMPFS_MAGIC, RAMFS_MAGIC = 0x01021994, 0x858458F6
UNSYNCHRONISED = 5  # returned by adjtimex while the wall clock is not synchronised


def examine_machine(*, memory: Path = MEMORY, system: Path = SYS) -> Iterator[Finding]:
    """Yield all findings on the properties of this machine that graphs depend on."""
    yield shared_memory(memory)
    yield leases(memory)
    yield disk(Path(tempfile.gettempdir()))
    yield open_files(resource.getrlimit(resource.RLIMIT_NOFILE), LEAST_FILES)
    yield cores(available_cores())
    yield governor(system)
    yield clock_source(system)
    yield wall_clock(_adjtimex())
    yield ports(AGENT_PORT, NODE_PORTS)


def ports(agent: int, nodes: tuple[int, int]) -> Finding:
    """Check that the default ports of agents and nodes are free or used by fovea."""
    what, wanted = "ports", {agent, *range(nodes[0], nodes[1] + 1)}
    try:
        found = psutil.net_connections("tcp")
    except psutil.Error:
        return warning(what, "what listens here is not told to this user", "run it as root")
    strangers = sorted(
        {c.laddr.port for c in found if c.status == psutil.CONN_LISTEN and not _is_fovea(c.pid)}
        & wanted
    )
    if strangers:
        taken = ", ".join(map(str, strangers))
        todo = "for a graph over several hosts: other `address` and `ports` in agent.yaml"
        return warning(what, f"something that is not this user's fovea listens on {taken}", todo)
    return ok(what, f"{agent} and {nodes[0]}-{nodes[1]} are to be had; one host needs none")


def _is_fovea(pid: int | None) -> bool:
    """Whether a process is visibly an agent or a node of a graph."""
    try:
        words = psutil.Process(pid).cmdline() if pid else []
    except psutil.Error:
        return False
    return any(Path(w).name == "fovea" or w in ("pipeline.cli", NODE) for w in words)


def shared_memory(folder: Path) -> Finding:
    """Check for shared memory in general; `needs` checks the amount for a graph."""
    what = "shared memory"
    try:
        room = os.statvfs(folder)
    except OSError as error:
        return wrong(what, f"{folder}: {error.strerror}", f"mount a tmpfs on {folder}")
    size_mb, free_mb = (blocks * room.f_frsize / 1e6 for blocks in (room.f_blocks, room.f_bavail))
    found = f"{folder}: {free_mb:.0f} MB of {size_mb:.0f} MB free"
    more = f"mount -o remount,size=1G {folder}, or give the container --shm-size=1g"
    if not os.access(folder, os.W_OK):
        return wrong(what, f"{folder}: not writable by this user", f"chmod 1777 {folder}")
    if free_mb < 1:
        return wrong(what, found, f"remove what fills it, or {more}")
    if free_mb < LEAST_SHARED_MB:
        return warning(what, found, more)
    if not _in_memory(folder):
        return warning(what, f"{found}, but on a disk", f"mount a tmpfs on {folder}")
    return ok(what, found)


def leases(folder: Path) -> Finding:
    """Check that the kernel locks of frame leases work there."""
    what = "frame leases"
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            request = struct.pack("hhqqi", fcntl.F_WRLCK, os.SEEK_SET, 0, 1, 0)
            fcntl.fcntl(file.fileno(), fcntl.F_OFD_SETLK, request)
    except OSError as error:
        todo = "use Linux 3.15 or newer, not gVisor"
        return wrong(what, f"open-file-description locks: {error.strerror}", todo)
    return ok(what, "open-file-description locks work")


def disk(folder: Path) -> Finding:
    """Check for disk space for logs and sockets."""
    free_mb = psutil.disk_usage(str(folder)).free / 1e6
    found = f"{folder}: {free_mb:.0f} MB free for logs"
    if free_mb < 1:
        return wrong("disk", found, "make room, or set TMPDIR to a folder that has some")
    if free_mb < LEAST_DISK_MB:
        return warning("disk", found, "make room, or set TMPDIR to a folder that has some")
    return ok("disk", found)


def open_files(limits: tuple[int, int], needed: int) -> Finding:
    """Check the limit of open files for the sockets and pools of one process."""
    soft, hard = limits
    found = f"{soft} allowed, about {needed} needed by the busiest process"
    if soft == resource.RLIM_INFINITY or soft >= 2 * needed:
        return ok("open files", found)
    todo = f"ulimit -n {4096 if hard in (-1,) or hard >= 4096 else hard}"
    return (warning if soft >= needed else wrong)("open files", found, todo)


def cores(count: float) -> Finding:
    """Check for two cores, since a node and its transport run at the same time."""
    found = f"{count:g} to use"
    if count < 2:
        todo = "give it two, or expect latencies of whole scheduling rounds"
        return warning("cores", found, todo)
    return ok("cores", found)


def governor(system: Path) -> Finding:
    """Check for a power-saving governor, which adds wake-up latency."""
    files = sorted(system.glob("cpu/cpu[0-9]*/cpufreq/scaling_governor"))
    found = sorted({file.read_text().strip() for file in files})
    if not found:
        return ok("governor", "none to be seen: the host decides (a virtual machine?)")
    if found == ["performance"]:
        return ok("governor", "performance")
    todo = "cpupower frequency-set -g performance (and compare `fovea top` before and after)"
    return warning("governor", ", ".join(found), todo)


def clock_source(system: Path) -> Finding:
    """Check that reading the clock is fast and precise enough to stamp every message."""
    resolution_ns = time.get_clock_info("monotonic").resolution * 1e9
    try:
        name = (system / "clocksource/clocksource0/current_clocksource").read_text().strip()
    except OSError:
        name = "unknown"
    found = f"monotonic, {resolution_ns:.0f} ns, from {name}"
    if resolution_ns > COARSEST_NS or name not in (*GOOD_CLOCKS, "unknown"):
        return warning("clock", found, "boot with clocksource=tsc, if the processor's is stable")
    return ok("clock", found)


def wall_clock(state: int | None) -> Finding:
    """Report the wall clock; one host does not use it, several measure their offsets."""
    if state is None:
        return ok("wall clock", "its state is not to be known here; no stamp depends on it")
    if state == UNSYNCHRONISED:
        return ok("wall clock", "nothing disciplines it (no NTP); no stamp depends on it")
    return ok("wall clock", "disciplined by NTP or PTP")


def _in_memory(folder: Path) -> bool:
    """Whether a folder is on a tmpfs, by the file system's magic number."""

    class _Statfs(ctypes.Structure):
        _fields_ = [("f_type", ctypes.c_long), ("rest", ctypes.c_byte * 512)]

    found = _Statfs()
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.statfs(os.fsencode(folder), ctypes.byref(found)) != 0:
        return True  # unknown: no reason to warn
    return found.f_type in (TMPFS_MAGIC, RAMFS_MAGIC)


def _adjtimex() -> int | None:
    """Return the kernel's state of the wall clock, without changing it; None if unavailable."""
    try:
        state = int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(512)))
    except (OSError, AttributeError):
        return None
    return state if state >= 0 else None
