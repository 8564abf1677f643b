"""The functions of the module rclpy itself."""

from __future__ import annotations

from typing import Any

from rosless.context import Context
from rosless.executors import Executor, SingleThreadedExecutor
from rosless.node import Node
from rosless.parameters.parameter import Parameter
from rosless.signals import SignalHandlerOptions, install_signal_handlers, uninstall_signal_handlers
from rosless.task import Future
from rosless.utilities import get_default_context, get_rmw_implementation_identifier, ok, try_shutdown
from rosless.utilities import shutdown as _shutdown

__all__ = [
    "Context",
    "Future",
    "Parameter",
    "SignalHandlerOptions",
    "create_node",
    "get_default_context",
    "get_global_executor",
    "get_rmw_implementation_identifier",
    "init",
    "install_signal_handlers",
    "ok",
    "shutdown",
    "spin",
    "spin_once",
    "spin_until_future_complete",
    "try_shutdown",
    "uninstall_signal_handlers",
]

_executor: Executor | None = None


def init(
    *,
    args: list[str] | None = None,
    context: Context | None = None,
    domain_id: int | None = None,
    signal_handler_options: SignalHandlerOptions | None = None,
) -> None:
    """Start: parse the ROS arguments, join the domain, and answer SIGINT and SIGTERM."""
    default = get_default_context()
    context = default if context is None else context
    if signal_handler_options is None:
        signal_handler_options = SignalHandlerOptions.ALL if context is default else SignalHandlerOptions.NO
    context.init(args, domain_id=domain_id)
    install_signal_handlers(signal_handler_options)


def shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    """End; an error if that has been done (see :func:`try_shutdown`)."""
    is_default = context is None or context is get_default_context()
    _shutdown(context=context)
    if uninstall_handlers or (uninstall_handlers is None and is_default):
        uninstall_signal_handlers()


def create_node(node_name: str, **options: Any) -> Node:
    """Create a node; the options are those of :class:`Node`."""
    return Node(node_name, **options)


def get_global_executor() -> Executor:
    """The executor of the spin functions."""
    global _executor
    executor = _executor
    if executor is None:
        executor = _executor = SingleThreadedExecutor()
        # calls back at once if a signal has just shut the context down
        executor.context.on_shutdown(_reset_executor)
    return executor


def _reset_executor() -> None:
    global _executor
    if _executor is not None:
        _executor.shutdown()
        _executor = None


def spin_once(node: Node, *, executor: Executor | None = None, timeout_sec: float | None = None) -> None:
    """Wait for one callback and run it."""
    executor = get_global_executor() if executor is None else executor
    try:
        executor.add_node(node)
        executor.spin_once(timeout_sec=timeout_sec)
    finally:
        executor.remove_node(node)


def spin(node: Node, executor: Executor | None = None) -> None:
    """Run callbacks until shutdown."""
    executor = get_global_executor() if executor is None else executor
    try:
        executor.add_node(node)
        executor.spin()
    finally:
        executor.remove_node(node)


def spin_until_future_complete(
    node: Node, future: Future, executor: Executor | None = None, timeout_sec: float | None = None
) -> None:
    """Run callbacks until a future is done, or time is up."""
    executor = get_global_executor() if executor is None else executor
    added = False
    try:
        added = executor.add_node(node)
        executor.spin_until_future_complete(future, timeout_sec)
    finally:
        if added:
            executor.remove_node(node)
