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
    size_px: tuple[int, int] = (480, 288),
    features: NDArray[np.float32] | None = None,
    **metadata: str,
) -> str:
    """Write a network with the same outputs for every picture; return its path."""
    width_px, height_px = size_px
    nodes, outputs, weights = [], [], []
    for name, array in {"output": output, "features": features}.items():
        if array is None:
            continue
        weights.append(numpy_helper.from_array(array, name + "_weights"))
        # the output must depend on the input, or ONNX Runtime removes the input
        nodes.append(helper.make_node("ReduceSum", ["images"], [name + "_sum"], keepdims=0))
        nodes.append(helper.make_node("Mul", [name + "_sum", "zero"], [name + "_none"]))
        nodes.append(helper.make_node("Add", [name + "_none", name + "_weights"], [name]))
        outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, array.shape))
    weights.append(numpy_helper.from_array(np.zeros((), np.float32), "zero"))
    images = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, height_px, width_px))
    graph = helper.make_graph(nodes, "constant", [images], outputs, weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    helper.set_model_props(model, metadata)
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
