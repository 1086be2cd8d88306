"""Write tiny ONNX networks whose outputs are known."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("onnx", reason="needs the train extra")
from onnx import TensorProto, helper, numpy_helper, save_model


def constant_network(
    path: Path,
    output: NDArray[np.float32],
    *,
    size_px: tuple[int | str, int | str] = (480, 288),
    features: NDArray[np.float32] | None = None,
    half: bool = False,
    more_inputs: tuple[str, ...] = (),
    batch: int | str = 1,
    planes: int = 3,
    **metadata: str,
) -> str:
    """Write a network with the same outputs for every picture; a side that is a text is open.

    Return its path.
    """
    width_px, height_px = size_px
    kind, dtype = (TensorProto.FLOAT16, np.float16) if half else (TensorProto.FLOAT, np.float32)
    nodes, outputs, weights = [], [], []
    for name, array in {"output": output, "features": features}.items():
        if array is None:
            continue
        weights.append(numpy_helper.from_array(array.astype(dtype), name + "_weights"))
        # the output must depend on the input, or ONNX Runtime removes the input
        nodes.append(helper.make_node("ReduceMax", ["images"], [name + "_most"], keepdims=0))
        nodes.append(helper.make_node("Mul", [name + "_most", "zero"], [name + "_none"]))
        nodes.append(helper.make_node("Add", [name + "_none", name + "_weights"], [name]))
        outputs.append(helper.make_tensor_value_info(name, kind, array.shape))
    weights.append(numpy_helper.from_array(np.zeros((), dtype), "zero"))
    shape = (batch, planes, height_px, width_px)
    inputs = [helper.make_tensor_value_info(n, kind, shape) for n in ("images", *more_inputs)]
    graph = helper.make_graph(nodes, "constant", inputs, outputs, weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, metadata)
    save_model(model, path)
    return str(path)


def changing_network(path: Path, *, size_px: tuple[int, int] = (480, 288)) -> str:
    """Write a detector that finds a ball in its input's middle, as surely as anything changed.

    The score is the greatest change of brightness, where 1 is from black to white.
    """
    width_px, height_px = size_px
    rest = np.zeros((1, 5, 64), np.float32)
    rest[0, :4, 0] = (width_px / 2, height_px / 2, 8, 8)
    none = np.zeros((1, 1, 63), np.float32)
    weights = [
        numpy_helper.from_array(array, name)
        for name, array in {
            "rest": rest, "none": none, "from": np.array([3]), "to": np.array([4]),
            "axis": np.array([1]), "shape": np.array([1, 1, 1]),
        }.items()
    ]  # fmt: skip
    nodes = [
        helper.make_node("Slice", ["images", "from", "to", "axis"], ["changed"]),
        helper.make_node("ReduceMax", ["changed"], ["most"], keepdims=0),
        helper.make_node("Reshape", ["most", "shape"], ["score"]),
        helper.make_node("Concat", ["score", "none"], ["scores"], axis=2),
        helper.make_node("Concat", ["rest", "scores"], ["output"], axis=1),
    ]
    images = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 4, height_px, width_px))
    output = helper.make_tensor_value_info("output", TensorProto.FLOAT, (1, 6, 64))
    graph = helper.make_graph(nodes, "changing", [images], [output], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, {"names": "['player', 'ball']", "difference": "True"})
    save_model(model, path)
    return str(path)


def counting_network(path: Path) -> str:
    """A network of whole numbers: (1, 3, 32, 32) bytes in, the same out."""
    sides = (1, 3, 32, 32)
    images = helper.make_tensor_value_info("images", TensorProto.UINT8, sides)
    same = helper.make_tensor_value_info("same", TensorProto.UINT8, sides)
    graph = helper.make_graph(
        [helper.make_node("Identity", ["images"], ["same"])], "n", [images], [same]
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    save_model(model, path)
    return str(path)


def mean_encoder(path: Path, *, batch: int | str, side_px: int | str, as_map: bool) -> str:
    """Write an encoder of each crop's mean red, green and blue: (n, 3) or (n, 3, 1, 1)."""
    crops = helper.make_tensor_value_info("crops", TensorProto.FLOAT, (batch, 3, side_px, side_px))
    shape = (batch, 3, 1, 1) if as_map else (batch, 3)
    means = helper.make_tensor_value_info("means", TensorProto.FLOAT, shape)
    node = helper.make_node("ReduceMean", ["crops"], ["means"], axes=[2, 3], keepdims=int(as_map))
    graph = helper.make_graph([node], "means", [crops], [means])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    save_model(model, path)
    return str(path)


def verifying_encoder(path: Path, *, names: str, classes: int) -> str:
    """Write a `mean_encoder` with logits of `classes`: ten times the red for the first, else 0."""
    crops = helper.make_tensor_value_info("crops", TensorProto.FLOAT, ("n", 3, 32, 32))
    outputs = [
        helper.make_tensor_value_info("features", TensorProto.FLOAT, ("n", 3)),
        helper.make_tensor_value_info("classes", TensorProto.FLOAT, ("n", classes)),
    ]
    taken = np.zeros((3, classes), np.float32)
    taken[0, 0] = 10
    nodes = [
        helper.make_node("ReduceMean", ["crops"], ["features"], axes=[2, 3], keepdims=0),
        helper.make_node("MatMul", ["features", "taken"], ["classes"]),
    ]
    weights = [numpy_helper.from_array(taken, "taken")]
    graph = helper.make_graph(nodes, "verifying", [crops], outputs, weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, {"classes": names})
    save_model(model, path)
    return str(path)
