"""Show a running graph in Rerun, in a file, a viewer or a browser."""

from operators.visualise.figures import latencies
from operators.visualise.pictures import jpeg
from operators.visualise.visualise import Visualise, VisualiseSettings

__all__ = ["Visualise", "VisualiseSettings", "jpeg", "latencies"]
