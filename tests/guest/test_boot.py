"""What a guest is made from: modules in order, an archive, and what is missing in a sentence."""

import gzip
import lzma
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.guest import boot, kernel


def unpacked(folder: Path, **depends: str) -> Path:
    """Return a folder like that of a kernel, with modules that depend on others."""
    place = folder / "usr" / "lib" / "modules" / "6.1" / "kernel"
    place.mkdir(parents=True)
    for name, others in depends.items():
        (place / f"{name}.ko").write_bytes(b"\x7fELF\0depends=" + others.encode() + b"\0")
    (folder / "boot").mkdir()
    (folder / "boot" / "vmlinuz-6.1").touch()
    return folder


def test_modules_are_loaded_after_those_that_they_depend_on(tmp_path: Path) -> None:
    found = boot.modules_of(unpacked(tmp_path, hcd="core,udc-core", core="", udc_core="core"))

    order = list(boot.in_order(found, ["hcd is_super_speed=1", "core", "built_in"]))

    assert order == ["core", "udc_core", "hcd is_super_speed=1"]


@pytest.mark.parametrize("suffix", ["xz", "gz", "zst"])
def test_a_compressed_module_is_read(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"core.ko.{suffix}"
    if suffix != "zst":
        path.write_bytes({"xz": lzma, "gz": gzip}[suffix].compress(b"module"))
    elif shutil.which("zstd") is None:
        pytest.skip("no zstd here")
    else:
        words = ["zstd", "--quiet", "--stdout"]
        path.write_bytes(
            subprocess.run(words, input=b"module", capture_output=True, check=True).stdout
        )

    assert boot.module_bytes(path) == b"module"


def test_a_module_that_the_kernel_has_built_in_is_not_lacking(tmp_path: Path) -> None:
    folder = unpacked(tmp_path, vhci_hcd="", dummy_hcd="", usb_f_fs="")
    (folder / "usr" / "lib" / "modules" / "6.1" / "modules.builtin").write_text(
        "kernel/fs/9p/9p.ko\nkernel/net/9p/9pnet_virtio.ko\n"
        "kernel/drivers/virtio/virtio-pci.ko\nkernel/drivers/media/vivid.ko\n"
    )

    assert boot.built_in(folder) == {"9p", "9pnet_virtio", "virtio_pci", "vivid"}
    assert boot.missing(folder) == boot.missing_programs()


@pytest.mark.skipif(bool(boot.missing_programs()), reason=boot.missing_programs())
def test_what_a_kernel_lacks_is_said(tmp_path: Path) -> None:
    assert "expected one unpacked kernel, got 0; `make guest-kernel`" in boot.missing(tmp_path)
    lacking = boot.missing(unpacked(tmp_path, vivid="", vhci_hcd=""))
    assert lacking.endswith("has no module virtio_pci, 9pnet_virtio, 9p, dummy_hcd, usb_f_fs")


@pytest.mark.skipif(bool(boot.missing_programs()), reason=boot.missing_programs())
def test_the_archive_is_unpacked_as_it_was_packed(tmp_path: Path) -> None:
    files = {"init": (0o100755, b"#!/bin/sh\n"), "bin/odd": (0o100644, b"123")}

    subprocess.run(
        [boot.BUSYBOX, "cpio", "-i"], cwd=tmp_path, input=boot.cpio(files), check=True,
        capture_output=True,
    )  # fmt: skip

    folders = {"bin", "proc", "sys", "dev", "host"}
    assert {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")} == folders | set(files)
    for name, (mode, data) in files.items():
        assert ((tmp_path / name).stat().st_mode, (tmp_path / name).read_bytes()) == (mode, data)


def test_a_folder_that_is_no_kernel_is_left_alone(tmp_path: Path) -> None:
    with pytest.raises(kernel.NoKernel, match="expected a folder with one kernel, or none"):
        kernel.get(tmp_path)


@pytest.mark.parametrize("program", ["boot", "kernel"])
def test_a_program_without_arguments_says_how_it_is_used(program: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", f"tests.guest.{program}"],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 1
    assert done.stderr.startswith(f"usage: python -m tests.guest.{program} ")


def test_a_command_that_fails_is_told_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(kernel.NoKernel, match=r"no-such-program: not there; .* Debian's"):
        kernel.run(["no-such-program"], tmp_path)
    with pytest.raises(kernel.NoKernel, match=r"E: none; `apt-get update` may help"):
        kernel.run(["sh", "-c", "echo W: x >&2; echo E: none >&2; exit 1"], tmp_path)
