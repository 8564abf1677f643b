"""ASAM's own libraries for OSI, the optional extra `exchange`: they are imported when OSI is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from skd_sim.errors import UsageError

HOW = "python -m pip install 'skd[exchange]'"


def osi_messages() -> Any:
    """Return the module with the class GroundTruth.

    Raises:
        UsageError: the library is not installed.
    """
    return _found("osi3.osi_groundtruth_pb2")


def osi_version() -> tuple[int, int, int]:
    """Return the version of OSI that its messages are of.

    Raises:
        UsageError: the library is not installed.
    """
    module = _found("osi3.osi_version_pb2")
    said = module.DESCRIPTOR.GetOptions().Extensions[module.current_interface_version]
    return int(said.version_major), int(said.version_minor), int(said.version_patch)


def osi_writer() -> Any:
    """Return the class that writes traces as MCAP.

    Raises:
        UsageError: the library is not installed.
    """
    return _found("osi_utilities.tracefile.writers.multi").MultiTraceWriter


def protobuf_version() -> str:
    """Return the version of protobuf that messages are written with."""
    return str(_found("google.protobuf").__version__)


def _found(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise UsageError(f"OSI needs osi-python and asam-osi-utilities: {HOW}") from error
