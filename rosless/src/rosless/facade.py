"""Which module of rosless stands behind which name of rclpy, and modules for message packages."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

from rosless import unsupported
from rosless.interfaces import packages, standard_services

# rclpy's module -> modules whose public names it has
_RCLPY: dict[str, tuple[str, ...]] = {
    "rclpy": ("api",),
    "rclpy._rclpy_pybind11": ("exceptions", "arguments", "time"),
    "rclpy.callback_groups": ("callback_groups",),
    "rclpy.client": ("client",),
    "rclpy.clock": ("clock", "time"),
    "rclpy.clock_type": ("time",),
    "rclpy.constants": ("constants",),
    "rclpy.context": ("context",),
    "rclpy.duration": ("duration",),
    "rclpy.endpoint_info": ("endpoint_info",),
    "rclpy.event_handler": ("event_handler",),
    "rclpy.exceptions": ("exceptions",),
    "rclpy.executors": ("executors",),
    "rclpy.expand_topic_name": ("names",),
    "rclpy.guard_condition": ("guard_condition",),
    "rclpy.impl": (),
    "rclpy.impl.logging_severity": ("logging",),
    "rclpy.impl.rcutils_logger": ("logging",),
    "rclpy.logging": ("logging",),
    "rclpy.node": ("node", "parameters.parameter", "qos", "publisher", "subscription"),
    "rclpy.parameter": ("parameters.parameter",),
    "rclpy.publisher": ("publisher",),
    "rclpy.qos": ("qos", "qos_compatibility"),
    "rclpy.qos_event": ("event_handler",),
    "rclpy.qos_overriding_options": ("unsupported",),
    "rclpy.serialization": ("serialization",),
    "rclpy.service": ("service",),
    "rclpy.signals": ("signals",),
    "rclpy.subscription": ("subscription",),
    "rclpy.task": ("task",),
    "rclpy.time": ("time",),
    "rclpy.time_source": ("time_source",),
    "rclpy.timer": ("timer",),
    "rclpy.topic_endpoint_info": ("endpoint_info",),
    "rclpy.topic_or_service_is_hidden": ("names",),
    "rclpy.type_hash": ("endpoint_info",),
    "rclpy.utilities": ("utilities",),
    "rclpy.validate_full_topic_name": ("names",),
    "rclpy.validate_namespace": ("names",),
    "rclpy.validate_node_name": ("names",),
    "rclpy.validate_parameter_name": ("names",),
    "rclpy.validate_topic_name": ("names",),
    "rclpy.wait_for_message": ("wait_for_message",),
}

# what "import rclpy" alone makes reachable as rclpy.<name>, as the real one does through its own imports
_IMPORTED_WITH_RCLPY = """
    callback_groups clock clock_type constants context duration event_handler exceptions executors guard_condition
    logging node parameter publisher qos service signals subscription task time timer utilities
""".split()  # noqa: SIM905


def serves(fullname: str) -> bool:
    """True if there is a module of this name here."""
    parts = fullname.split(".")
    if parts[0] == "rclpy":
        return fullname in _RCLPY or fullname in unsupported.MODULES
    if len(parts) == 1:
        return packages.exists(parts[0])
    if parts[1] == "srv" and not _has_services(parts[0]):
        return False
    return len(parts) == 2 or _class_of_module(*parts) is not None


def is_package(fullname: str) -> bool:
    """True if the module of this name can have submodules."""
    parts = fullname.split(".")
    return fullname in ("rclpy", "rclpy.impl", "rclpy.action") or (parts[0] != "rclpy" and len(parts) < 3)


def fill(module: ModuleType, fullname: str) -> None:
    """Give a new module its names."""
    parts = fullname.split(".")
    if parts[0] == "rclpy":
        _fill_rclpy(module, fullname)
    elif len(parts) == 2:
        _fill_interfaces(module, parts[0], parts[1])
    elif len(parts) == 3:
        short = _class_of_module(*parts)
        assert short is not None
        setattr(module, short, _interface(parts[0], parts[1], short))


def _fill_rclpy(module: ModuleType, fullname: str) -> None:
    if fullname in unsupported.MODULES:
        unsupported.refuse(fullname)
    public: dict[str, Any] = {}
    for name in _RCLPY[fullname]:
        implementation = importlib.import_module(f"rosless.{name}")
        listed = getattr(implementation, "__all__", None)
        found = vars(implementation) if listed is None else {key: getattr(implementation, key) for key in listed}
        for key, value in found.items():
            if not key.startswith("_") and key != "annotations" and not isinstance(value, ModuleType):
                public[key] = value
        module.__doc__ = module.__doc__ or implementation.__doc__
    vars(module).update(public)
    if fullname == "rclpy":
        for name in _IMPORTED_WITH_RCLPY:
            setattr(module, name, importlib.import_module(f"rclpy.{name}"))


def _fill_interfaces(module: ModuleType, package: str, kind: str) -> None:
    from rosless.interfaces import definitions

    available = definitions.message_names(package) if kind == "msg" else definitions.service_names(package)

    def get(name: str) -> Any:
        if name not in available:
            raise AttributeError(f"module {module.__name__!r} has no attribute {name!r}")
        value = _interface(package, kind, name)
        setattr(module, name, value)
        return value

    # classes are made when they are asked for: a package may have dozens
    vars(module).update({"__getattr__": get, "__all__": available, "__dir__": lambda: list(available)})


def complete_namespace(module: ModuleType) -> None:
    """Give a module its names that the import system made from the mere folder of a message package.

    With a workspace's src folder on the path, ``skd_msgs/msg`` is a namespace package without content.
    """
    package, _, kind = module.__name__.partition(".")
    if getattr(module, "__file__", None) is None and "__getattr__" not in vars(module) and packages.exists(package):
        _fill_interfaces(module, package, kind)


def _interface(package: str, kind: str, short: str) -> Any:
    from rosless.interfaces import classes

    if kind == "srv":
        return classes.service_class(package, short)
    return classes.message_class(f"{package}/msg/{short}")


def _has_services(package: str) -> bool:
    if package in standard_services.TEXTS:
        return True
    folder = packages.find(package)
    return folder is not None and bool(packages.interface_files(folder, "srv"))


def _class_of_module(package: str, kind: str, module: str) -> str | None:
    from rosless.interfaces import classes, definitions

    available = definitions.message_names(package) if kind == "msg" else definitions.service_names(package)
    if kind == "srv":
        available = [f"{name}{half}" for name in available for half in ("", "_Request", "_Response")]
    for name in available:
        if module == f"_{classes.snake_case(name)}":
            return name
    return None
