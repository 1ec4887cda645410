"""Parameters of a node: described, checked, and closed to later changes if read only once."""

from collections.abc import Collection
from typing import TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType
from rclpy.node import Node

from im_core.errors import ConfigError, DataError, ImError, NotFoundError

ValueT = TypeVar("ValueT", bool, int, float, str)

_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


class DeclaredParameters:
    """Declare the parameters of a node; read-only unless declared changeable.

    A wrong value that is given at the start does not keep the node from being made: its default stands in, and
    :attr:`fault` says what is wrong, for the node to fail with when it is configured.

    Attributes:
        fault: What is wrong with the first wrong value; None if all are right.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.fault: ImError | None = None
        describe_sim_time(node)

    def declare(
        self,
        name: str,
        default: ValueT,
        description: str,
        *,
        span: tuple[float, float] | None = None,
        known: Collection[str] = (),
        changeable: bool = False,
    ) -> ValueT:
        """Declare a parameter and return the value.

        Args:
            name: Its name.
            default: Its value where none is given; says of what type it is. A whole number does for a float.
            description: What it is, with its unit.
            span: Least and largest value, both allowed.
            known: The texts that are allowed; empty: any.
            changeable: Whether it may be changed at any time.
        """
        given = self._node._parameter_overrides.get(name)  # rclpy's own checks say less, and end the node
        value = default
        if given is not None:
            try:
                value = self._typed(name, given.value, default)
                self._check(name, value, span, known)
            except ImError as error:
                self.fault, value = self.fault or error, default
        descriptor = ParameterDescriptor(description=description, read_only=not changeable)
        if known:
            descriptor.additional_constraints = f"one of {', '.join(known)}"
        if span is not None and isinstance(default, int):
            descriptor.integer_range = [IntegerRange(from_value=int(span[0]), to_value=int(span[1]))]
        elif span is not None:
            descriptor.floating_point_range = [FloatingPointRange(from_value=span[0], to_value=span[1])]
        self._node.declare_parameter(name, value, descriptor, ignore_override=True)
        return value

    def check_given(self) -> None:
        """Check all parameters given at the start, after all declarations: each must be known.

        Raises:
            NotFoundError: A parameter is not; it would have no effect.
        """
        for name in self._node._parameter_overrides:
            if not self._node.has_parameter(name):
                kind = f"parameter of {self._node.get_fully_qualified_name()}"
                raise NotFoundError(kind=kind, name=name, known=self._node.get_parameters_by_prefix(""))

    def _typed(self, name: str, value: object, default: ValueT) -> ValueT:
        """Return the value, if of the type of ``default``.

        Raises:
            ConfigError: It is not.
        """
        kind = type(default)
        if kind is float and type(value) is int:
            value = float(value)
        if type(value) is kind:
            return value
        node = self._node.get_fully_qualified_name()
        raise ConfigError(f"parameter {name} of {node} is {value!r}, not {_WORDS[kind]}", parameter=name)

    def _check(self, name: str, value: object, span: tuple[float, float] | None, known: Collection[str]) -> None:
        """Check a value against span and known texts.

        Raises:
            DataError: It is out of range.
            NotFoundError: It is none of the texts that are allowed.
        """
        node = self._node.get_fully_qualified_name()
        if isinstance(value, str):
            if known and value not in known:
                raise NotFoundError(kind=f"value of the parameter {name} of {node}", name=value, known=known)
        elif isinstance(value, int | float) and span is not None and not span[0] <= value <= span[1]:
            low, high = span
            raise DataError(f"{name} {value} of {node} is not between {low:g} and {high:g}", name=name, value=value)


def describe_sim_time(node: Node) -> None:
    """Describe ``use_sim_time``, a parameter of every node; rclpy leaves the description out."""
    told = "take the time from /clock, which the testbed publishes"
    descriptor = ParameterDescriptor(description=told, type=ParameterType.PARAMETER_BOOL)
    node.set_descriptor("use_sim_time", descriptor)
