"""Networks run without telemetry and write nothing into the user's home."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LOAD = "from pipeline.inference import Network; Network('operators/policy/policy.onnx')"


def test_a_network_is_loaded_without_a_trace_in_the_users_home(tmp_path: Path) -> None:
    env = {**os.environ, "HOME": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    env.pop("ORT_DISABLE_TELEMETRY", None)

    subprocess.run([sys.executable, "-c", LOAD], env=env, cwd=ROOT, check=True)

    assert list(tmp_path.rglob("*")) == []
