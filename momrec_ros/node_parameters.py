"""The parameters of `momrec_ros.parameters` as those of a ROS node."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from momrec_ros.parameters import Parameter

__all__ = ["declare_parameters"]

OF_EVERY_NODE = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def declare_parameters(
    node: Node, parameters: Iterable[Parameter[Any]], given: Mapping[str, Any]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Declare parameters, with the values that the node was started with where they will do.

    What rclpy declares by itself may have no value (an empty list, null), which it fails at.

    Parameters
    ----------
    node : Node
        Without these parameters so far.
    parameters : iterable of Parameter
        Those that the node knows.
    given : mapping
        Name to the value that the node was started with.

    Returns
    -------
    problems : dict
        Name to what is wrong with the value given; such a parameter has its default for now.
    unknown : tuple of str
        Names of given parameters that the node does not know.
    """
    problems = {}
    for parameter in parameters:
        value = parameter.default
        if parameter.name in given:
            problem = parameter.problem_with(given[parameter.name])
            if problem:
                problems[parameter.name] = problem
            else:  # whole numbers will do for doubles
                value = type(parameter.default)(given[parameter.name])
        node.declare_parameter(parameter.name, value, _descriptor(parameter), ignore_override=True)
    known = {parameter.name for parameter in parameters}
    unknown = tuple(
        name for name in given if name not in known and not name.startswith(OF_EVERY_NODE)
    )
    return problems, unknown


def _descriptor(parameter: Parameter[Any]) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=parameter.description, read_only=parameter.read_only
    )
    if parameter.choices:
        descriptor.additional_constraints = f"one of {parameter.allowed}"
    if isinstance(parameter.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=parameter.minimum, to_value=parameter.maximum)
        ]
    elif parameter.minimum is not None:
        descriptor.integer_range = [
            IntegerRange(from_value=parameter.minimum, to_value=parameter.maximum)
        ]
    return descriptor
