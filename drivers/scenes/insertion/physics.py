"""MuJoCo: a model of gym-aloha in; joint positions, contacts and pictures out.

The only module that imports MuJoCo. The models are files of the package gym-aloha, whose own code
is not used: it draws three cameras with shadows in every step (240 ms, where this takes 8), and the
states are the same (tests/drivers/test_insertion.py).
"""

import ctypes.util
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import DriverError

RATE_HZ = 50.0  # of control
SUBSTEPS = 10  # of 2 ms
SIZE_PX = (640, 480)  # of the pictures of ALOHA
INSTALL = "pip install 'fovea[robot]'"
LIBRARIES = "apt install libosmesa6"
SAMPLES = 0  # of antialiasing: 4, as in the model, cost six times the time without a GPU


class Physics:
    """The state of one simulation; `step` advances it by one period of control."""

    def __init__(self, model: str) -> None:
        mujoco = _mujoco()
        self._model = loaded = mujoco.MjModel.from_xml_path(str(_models() / f"{model}.xml"))
        loaded.vis.quality.offsamples = SAMPLES
        # a weld as soft as in the model lets the arms lag behind the commanded poses
        loaded.eq_solimp[:, :2] = 0.9
        self._data = mujoco.MjData(loaded)

    def reset(self, positions: NDArray[np.float64], controls: NDArray[np.float64]) -> None:
        """Begin at rest with these joint positions and commands."""
        mujoco = _mujoco()
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = positions
        self._data.ctrl[:] = controls
        mujoco.mj_forward(self._model, self._data)

    def step(self, controls: NDArray[np.float64]) -> None:
        """Hold these commands for one period; contacts are those of the new state."""
        mujoco = _mujoco()
        self._data.ctrl[:] = controls
        mujoco.mj_step2(self._model, self._data)
        for _ in range(SUBSTEPS - 1):
            mujoco.mj_step(self._model, self._data)
        mujoco.mj_step1(self._model, self._data)

    def pull(self, positions: NDArray[np.float64], rotations: NDArray[np.float64]) -> None:
        """Move the bodies that the grippers are welded to: (2, 3) metres, (2, 4) quaternions."""
        self._data.mocap_pos[:] = positions
        self._data.mocap_quat[:] = rotations

    @property
    def positions(self) -> NDArray[np.float64]:
        """Of all joints: 8 of each arm, then position and quaternion of peg and socket."""
        return np.array(self._data.qpos)

    @property
    def velocities(self) -> NDArray[np.float64]:
        """Of all joints; 6 numbers for peg and socket each."""
        return np.array(self._data.qvel)

    def contacts(self) -> set[frozenset[str]]:
        """Names of the shapes that touch, in pairs."""
        name = self._model.geom
        return {frozenset((name(a).name, name(b).name)) for a, b in self._data.contact.geom}

    def corners(self, shapes: tuple[str, ...]) -> NDArray[np.float64]:
        """The (8 k, 3) corners of boxes around shapes, along their own axes, metres."""
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
        found = []
        for shape in shapes:
            seen = self._data.geom(shape)
            box = self._model.geom_aabb[self._model.geom(shape).id]
            found.append(seen.xpos + (box[:3] + signs * box[3:]) @ seen.xmat.reshape(3, 3).T)
        return np.concatenate(found)

    def projected(self, points: NDArray[np.float64], camera: str) -> NDArray[np.float64]:
        """Pixels (n, 2) of points (n, 3) in a picture of `SIZE_PX` by a camera."""
        seen = self._data.cam(camera)
        local = (points - seen.xpos) @ seen.xmat.reshape(3, 3)
        width, height = SIZE_PX
        focal_px = height / 2 / np.tan(np.radians(self._model.cam(camera).fovy[0]) / 2)
        x, y = focal_px * local[:, 0] / -local[:, 2], focal_px * local[:, 1] / local[:, 2]
        return np.stack([width / 2 + x, height / 2 + y], 1)


class Camera:
    """Draws a simulation, for one thread at a time."""

    def __init__(self, physics: Physics, name: str) -> None:
        mujoco, (width, height) = _mujoco(), SIZE_PX
        self._physics, self._model = physics, physics._model
        self._context = _gl_context(width, height)
        self._context.make_current()
        self._drawn = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawn)
        self._scene = mujoco.MjvScene(self._model, maxgeom=1000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._options = mujoco.MjvOption()
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._view.fixedcamid = self._model.cam(name).id
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._upside_down = np.empty((height, width, 3), np.uint8)

    def picture(self) -> NDArray[np.uint8]:
        """The present state as (480, 640, 3) RGB, valid until the next call."""
        mujoco = _mujoco()
        self._context.make_current()
        mujoco.mjv_updateScene(
            self._model, self._physics._data, self._options, None, self._view,
            mujoco.mjtCatBit.mjCAT_ALL.value, self._scene,
        )  # fmt: skip
        mujoco.mjr_render(self._rectangle, self._scene, self._drawn)
        mujoco.mjr_readPixels(self._upside_down, None, self._rectangle, self._drawn)
        return self._upside_down[::-1]

    def close(self) -> None:
        """Release the context; the thread that drew has ended, or is this one."""
        self._context.make_current()
        self._drawn.free()
        self._context.free()


def _mujoco() -> Any:
    try:
        import mujoco
    except ModuleNotFoundError as error:
        raise DriverError(f"insertion: MuJoCo is not installed: {INSTALL}") from error
    return mujoco


def _models() -> Path:
    found = importlib.util.find_spec("gym_aloha")
    if found is None or not found.submodule_search_locations:
        raise DriverError(f"insertion: gym-aloha is not installed: {INSTALL}")
    return Path(found.submodule_search_locations[0]) / "assets"


def _gl_context(width: int, height: int) -> Any:
    """OSMesa where it is installed, for the same pictures with and without a GPU; else EGL.

    PyOpenGL has one platform in a process, so that a second one cannot be tried.
    """
    try:
        if ctypes.util.find_library("OSMesa"):
            from mujoco.osmesa import GLContext
        else:
            from mujoco.egl import GLContext
        return GLContext(width, height)
    except Exception as error:  # their errors share no base class
        raise DriverError(
            f"insertion: MuJoCo draws by OSMesa or EGL, of which none works here: {LIBRARIES}"
        ) from error
