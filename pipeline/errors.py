"""Everything fovea raises on purpose, as one family.

FoveaError
├── SettingsError   a setting is missing, unknown, of the wrong type or out of range
├── GraphError      a graph file does not describe a graph that can run
├── MessageError    bytes or arrays that are not the message they claim to be
├── PoolExhausted   every slot of a frame pool is still leased
├── DriverError     a sensor, a file or a data set does not deliver
├── WeightsError    a network's weights are absent or not the ones named
├── InstallError    a package that an extra brings is not installed
└── RunError        a running graph cannot go on
    └── Silent      no answer came in time

A message says where, what, what was expected and what was got.
"""


class FoveaError(Exception):
    """Base of the family: the command line prints it as one sentence, without a traceback."""


class SettingsError(FoveaError, ValueError):
    """A setting is missing, unknown, of the wrong type or out of range."""


class GraphError(FoveaError):
    """A graph file does not describe a graph that can run."""


class MessageError(FoveaError):
    """Bytes or arrays that are not the message they claim to be."""


class PoolExhausted(FoveaError):
    """Every slot of a frame pool is still leased."""


class DriverError(FoveaError):
    """A sensor, a file or a data set does not deliver what it should."""


class WeightsError(FoveaError):
    """A network's weights are absent or not the ones named."""


class InstallError(FoveaError):
    """A package that an extra brings is not installed."""


class RunError(FoveaError):
    """A running graph cannot go on."""


class Silent(RunError):
    """Who was asked does not answer in time."""
