"""Hook in rclpy's conversion of messages from C to objects: a too long message is found before the conversion.

To make objects of 10^6 texts takes rclpy seconds, in which no thread of the node runs. What hooks in here relies on the
four capsules that rosidl gives every generated class, and on its layout of sequences and texts.
"""

import ctypes
from collections.abc import Callable
from typing import Any


class Sequence(ctypes.Structure):
    """As rosidl has sequences and texts."""

    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))


CONVERT = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)
"""Of a generated class: makes an object of the message at an address."""

_functions: list[Any] = []
"""Functions whose address a capsule holds; they live as long as the process."""


def capsule(function: Any) -> Any:
    """Return a capsule, in the form of a generated class, of a function of ctypes."""
    make = ctypes.pythonapi.PyCapsule_New
    make.restype, make.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    _functions.append(function)
    return make(ctypes.cast(function, ctypes.c_void_p), None, None)


def converter(message: Any) -> Callable[[int], Any]:
    """Return the converter of a generated class, from address to object; rclpy must have loaded the type support."""
    address = ctypes.pythonapi.PyCapsule_GetPointer
    address.restype, address.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    convert: Callable[[int], Any] = CONVERT(address(type(message)._CONVERT_TO_PY, None))
    return convert


def converted_by(message: Any, convert: Callable[[int], Any]) -> Any:
    """Return a class of messages for rclpy in place of `message`, with data at an address converted by `convert`."""
    kind = type(message)
    return type("ConvertingMetaclass", (kind,), {"_CONVERT_TO_PY": capsule(CONVERT(convert))})("Converted", (), {})
