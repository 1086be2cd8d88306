"""Every error that fovea raises on purpose, as one family.

FoveaError
├── SettingsError   a setting is missing, unknown, of the wrong type or out of range
├── GraphError      a graph file does not describe a graph that can run
├── MessageError    bytes or arrays do not form a valid message
├── PoolExhausted   every slot of a frame pool is still leased
├── DriverError     a sensor, a file or a data set does not deliver what it should
├── WeightsError    a network's weights are missing or have the wrong checksum
├── InstallError    a package of an optional extra is not installed
└── RunError        a running graph cannot continue
    ├── Busy        it does something else now: the same order may succeed a moment later
    └── Silent      no answer came in time

Every message names the place and the subject, what was expected and what was found.
"""


class FoveaError(Exception):
    """Base of the family: the command line prints it as one sentence, without a traceback."""


class SettingsError(FoveaError, ValueError):
    """A setting is missing, unknown, of the wrong type or out of range."""


class GraphError(FoveaError):
    """A graph file does not describe a graph that can run."""


class MessageError(FoveaError):
    """Bytes or arrays do not form a valid message."""


class PoolExhausted(FoveaError):
    """Every slot of a frame pool is still leased."""


class DriverError(FoveaError):
    """A sensor, a file or a data set does not deliver what it should."""


class WeightsError(FoveaError):
    """A network's weights are missing or have the wrong checksum."""


class InstallError(FoveaError):
    """A package of an optional extra is not installed."""


class RunError(FoveaError):
    """A running graph cannot continue."""


class Busy(RunError):
    """A graph is changing; the same order may succeed when that has ended."""


class Silent(RunError):
    """A process or host did not answer before the deadline."""
