"""What a process tells of the code that it has imported; the check of a received plan's code."""

import importlib.util
import os
from collections.abc import Iterable, Mapping
from itertools import islice

from pipeline.errors import GraphError
from pipeline.graph.plan import Node
from pipeline.graph.ports import check_fingerprints, check_operators, declared_ports
from pipeline.module_files import module_files
from pipeline.protocol.supervision import Fits, Imported, Inspect

MOST_FILES = 1000  # limit of reported source files


def imported(nodes: Iterable[Node]) -> Imported:
    """Return the ports of imported operators, and the files of imported code of the user's own."""
    operators = {node.operator for node in nodes}
    files = list(islice(module_files(), MOST_FILES))
    return Imported({operator: declared_ports(operator) for operator in operators}, files)


def inspect(job: Inspect) -> Fits:
    """Return the ports of the operators of this host.

    Raises `FoveaError` for operators, settings or messages that do not fit the plan, and for a
    module that is not the file whose checksum was compared.
    """
    check_files(job.files)
    check_operators(job.plan)
    check_fingerprints(job.plan, job.fingerprints)
    ports = imported(filter(job.plan.is_here, job.plan.nodes)).ports
    return Fits(Imported(ports))  # without files: nothing reads them


def check_files(files: Mapping[str, str]) -> None:
    """Raise `GraphError` for a module that Python would import from another file than given.

    The packages around a module are imported: they may redirect the import.
    """
    for module, file in files.items():
        spec = importlib.util.find_spec(module)
        found = spec.origin if spec is not None and spec.origin else "nothing"
        if os.path.realpath(found) != os.path.realpath(file):
            raise GraphError(f"{module}: expected the code in {file}, got {found}")
