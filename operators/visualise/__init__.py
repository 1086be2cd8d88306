"""Show a running graph in Rerun, in a file, a viewer or a browser."""

from operators.visualise.visualise import Visualise, VisualiseSettings, jpeg, latencies

__all__ = ["Visualise", "VisualiseSettings", "jpeg", "latencies"]
