"""Whether a value fits a parameter's descriptor. The reasons are worded as rclpy words them."""

from __future__ import annotations

import math
from typing import Any

from rosless.parameters.parameter import Parameter, ParameterType

# Relative tolerance of comparisons of floating-point values with limits and steps.
RELATIVE_TOLERANCE = 1e-6


def problem(parameter: Parameter, descriptor: Any, *, declared: bool, check_read_only: bool) -> str:
    """Why a value may not be set, or an empty string. Also completes the descriptor's name and type."""
    descriptor.name = parameter.name
    if check_read_only and descriptor.read_only:
        return f"Trying to set a read-only parameter: {parameter.name}."
    if descriptor.dynamic_typing:
        descriptor.type = parameter.type_.value
    elif declared and parameter.type_ is ParameterType.NOT_SET:
        return "Static parameter cannot be undeclared"
    elif parameter.type_ is not ParameterType.NOT_SET and parameter.type_.value != descriptor.type:
        expected = ParameterType(descriptor.type)
        return f"Wrong parameter type, expected '{expected}' got '{parameter.type_}'"
    if parameter.type_ is ParameterType.INTEGER and descriptor.integer_range:
        return _integer_problem(parameter, descriptor.integer_range[0])
    if parameter.type_ is ParameterType.DOUBLE and descriptor.floating_point_range:
        return _double_problem(parameter, descriptor.floating_point_range[0])
    return ""


def _integer_problem(parameter: Parameter, limits: Any) -> str:
    low, high = sorted((limits.from_value, limits.to_value))
    value = parameter.value
    if value in (low, high):
        return ""
    if not low < value < high:
        return f"Parameter {parameter.name} out of range. Min: {low}, Max: {high}, value: {value}"
    if limits.step != 0 and (value - low) % limits.step != 0:
        return (
            f"The parameter value for {parameter.name} is not a valid step. "
            f"Min: {low}, max: {high}, value: {value}, step: {limits.step}"
        )
    return ""


def _double_problem(parameter: Parameter, limits: Any) -> str:
    low, high = sorted((limits.from_value, limits.to_value))
    value = parameter.value
    if _close(value, low) or _close(value, high):
        return ""
    if not low < value < high:
        return f"Parameter {parameter.name} out of range Min: {low}, Max: {high}, value: {value}"
    if limits.step != 0.0:
        steps = round((value - low) / limits.step)
        if not _close(low + steps * limits.step, value):
            return (
                f"The parameter value for {parameter.name} is not close enough to a valid step. "
                f"Min: {low}, max: {high}, value: {value}, step: {limits.step}"
            )
    return ""


def _close(left: float, right: float) -> bool:
    return math.isclose(left, right, rel_tol=RELATIVE_TOLERANCE)
