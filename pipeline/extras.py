"""Optional packages: which extra installs each of them, and modules imported on first use."""

from importlib import import_module
from typing import Any

from pipeline.errors import InstallError

EXTRAS = {  # by the name that is imported
    "PIL": "text",
    "cryptography": "fleet",
    "fontTools": "text",
    "google": "record",
    "gym_aloha": "robot",
    "h5py": "robot",
    "matplotlib": "eval",
    "mcap": "record",
    "mujoco": "robot",
    "onnx": "train",
    "opentelemetry": "trace",
    "prometheus_client": "metrics",
    "rapidocr": "text",
    "rerun": "view",
    "torch": "train",
    "trackeval": "mot",
    "usb": "usb",
    "zstandard": "record",
}
PACKAGES = {
    "PIL": "pillow",
    "fontTools": "fonttools",
    "google": "protobuf",
    "gym_aloha": "gym-aloha",
    "opentelemetry": "opentelemetry-sdk",
    "prometheus_client": "prometheus-client",
    "rerun": "rerun-sdk",
    "usb": "pyusb",
}  # whose name is another
INDEX = {"train": "https://download.pytorch.org/whl/cpu"}
WHY = "torch for processors alone; without the index pip takes CUDA along, 5.4 GB"


def remedy(error: ModuleNotFoundError) -> str:
    """Say which package is missing and how to install it; empty for a module of no extra.

    >>> remedy(ModuleNotFoundError("no", name="matplotlib.pyplot"))
    "expected the package matplotlib, got none: pip install 'fovea[eval]'"
    >>> remedy(ModuleNotFoundError("no", name="mine"))
    ''
    """
    package = (error.name or "").partition(".")[0]
    extra = EXTRAS.get(package)
    if extra is None:
        return ""
    index = f" --extra-index-url {INDEX[extra]} ({WHY})" if extra in INDEX else ""
    package = PACKAGES.get(package, package)
    return f"expected the package {package}, got none: pip install 'fovea[{extra}]'{index}"


def need(package: str, where: str) -> None:
    """Raise `InstallError` beginning with `where` unless a package is installed."""
    try:
        import_module(package)
    except ModuleNotFoundError as error:
        raise InstallError(f"{where}: {remedy(error) or error}") from error


class LateModule:
    """A module that is imported on first use of one of its names.

    Not by a name with two underscores: tools that only look at an object ask for those.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(import_module(self._name), name)
