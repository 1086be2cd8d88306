"""The command line loads what a command needs, and nothing for `--help`."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from pipeline.cli import TABLE, commands

ENTRY = (sys.executable, "-m", "pipeline.entry")
HEAVY = (
    "numpy", "zenoh", "pydantic", "msgspec", "rich", "cryptography", "ruamel", "psutil", "scipy",
    "onnxruntime", "cv2", "rerun", "matplotlib", "torch", "importlib.metadata", "packaging",
    "pipeline.contract", "pipeline.messages", "pipeline.fleet", "pipeline.run", "pipeline.doctor",
)  # fmt: skip
LOADED = f"""
import sys
from pipeline import cli
try:
    cli.main()
finally:
    print("loaded:", [m for m in {HEAVY} if m in sys.modules])
"""
MISSING = """
import sys
from importlib.abc import MetaPathFinder

class Nowhere(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("cryptography", "matplotlib", "torch", "onnx"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Nowhere())
from pipeline import cli
cli.main()
"""
INDEX = (
    " --extra-index-url https://download.pytorch.org/whl/cpu "
    "(torch for processors alone; without the index pip takes CUDA along, 5.4 GB)"
)


def python(code: str, *words: str, cwd: Path | None = None) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("words", [["--help"], ["-h"], []])
def test_what_only_lists_the_commands_imports_nothing_heavy(words: list[str]) -> None:
    done = python(LOADED, *words)

    assert done.stdout.splitlines()[-1] == "loaded: []", done.stdout + done.stderr


@pytest.mark.parametrize("name", sorted(TABLE))
def test_the_summary_of_a_command_uses_the_words_of_its_help(name: str) -> None:
    loaded = commands.commands[name].loaded()  # type: ignore[attr-defined]

    def plain(text: str) -> list[str]:
        return re.findall(r"\w+", text.lower())

    summary, own = plain(TABLE[name][1]), plain(loaded.help or "")
    assert loaded.name == name
    assert isinstance(loaded, click.Command)
    assert summary[0] == own[0]
    assert set(summary) <= set(own)


def test_help_of_a_command_is_that_of_the_command_itself() -> None:
    said = CliRunner().invoke(commands, ["check", "--help"])

    assert said.exit_code == 0
    assert "--no-import" in said.output


def test_a_word_that_is_no_command_is_refused() -> None:
    said = CliRunner().invoke(commands, ["rum"])

    assert said.exit_code == 2
    assert "No such command 'rum'" in said.output


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["secure", "init", "certificates"], "secure: expected the package cryptography, got none: "
         "pip install 'fovea[fleet]'"),
        (["train", "tracking", "--data", "d", "--out", "o"], "train: expected the package "
         f"torch, got none: pip install 'fovea[train]'{INDEX}"),
    ],
)  # fmt: skip
def test_a_command_whose_extra_is_missing_is_refused_in_one_sentence(
    words: list[str], said: str, tmp_path: Path
) -> None:
    done = python(MISSING, *words, cwd=tmp_path)

    assert (done.returncode, done.stderr) == (2, f"fovea: {said}\n")
    assert list(tmp_path.iterdir()) == []


def test_a_plot_without_its_extra_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    words = ("eval", "tracking", "--data", "procedural", "--plot", "figure.png")

    done = python(MISSING, *words, cwd=tmp_path)

    assert done.returncode == 2
    assert done.stderr == (
        "fovea eval tracking: --plot: expected the package matplotlib, got none: "
        "pip install 'fovea[eval]'\n"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        *(["check", "tracking"], ["ps"], ["weights", "list"], ["eval", "--help"]),
        ["train", "tracking", "--help"],
    ],
)
def test_the_main_job_needs_no_extra(words: list[str], tmp_path: Path) -> None:
    done = python(MISSING, *words, cwd=tmp_path)

    assert done.returncode == 0, done.stderr


@pytest.mark.lengthy
def test_a_graph_runs_without_any_extra(tmp_path: Path) -> None:
    done = python(MISSING, "run", "tracking", "--inline", "--frames", "2", cwd=tmp_path)

    assert done.returncode == 0, done.stderr
    assert "frames/s over 2 frames" in done.stdout


def test_an_unknown_graph_is_refused_with_those_that_are_shipped(tmp_path: Path) -> None:
    done = subprocess.run(
        [*ENTRY, "run", "trackin"], cwd=tmp_path, capture_output=True, text=True, check=False
    )

    assert done.returncode == 2
    assert done.stderr.startswith("fovea: 'trackin': no such graph; did you mean 'tracking'?")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_shell_gets_its_script(shell: str) -> None:
    done = subprocess.run(
        [*ENTRY, "completion", shell], capture_output=True, text=True, check=False
    )

    assert done.returncode == 0, done.stderr
    assert "_FOVEA_COMPLETE" in done.stdout


@pytest.mark.parametrize(
    ("line", "expected"),
    [("fovea ru", {"run"}), ("fovea run track", {"tracking"}), ("fovea weights p", {"pull"})],
)
def test_bash_completes_commands_and_names_of_graphs(
    line: str, expected: set[str], tmp_path: Path
) -> None:
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("there is no bash")
    words = line.split()
    (tmp_path / "fovea").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$0.py" "$@"\n')
    (tmp_path / "fovea").chmod(0o700)
    (tmp_path / "fovea.py").write_text(
        "import sys; sys.argv[0] = 'fovea'; from pipeline.entry import main; main()"
    )
    told = "; ".join(
        [
            f'PATH="{tmp_path}:$PATH"',
            'eval "$(fovea completion bash)"',
            f"COMP_WORDS=({line})",
            f"COMP_CWORD={len(words) - 1}",
            "_fovea_completion fovea",
            'echo "${COMPREPLY[@]}"',
        ]
    )

    done = subprocess.run([bash, "-c", told], capture_output=True, text=True, check=False)

    assert expected <= set(done.stdout.split()), done.stdout + done.stderr
