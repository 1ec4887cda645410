"""Times of transitions in a net file: one of several distributions [s]."""

import math
from types import NoneType
from typing import Annotated, Self, get_args

import pydantic
from pydantic import BeforeValidator, Field

from im_core.config import FieldError
from im_core.errors import nearest
from im_pnt.netfile.schema.scalars import WrongKeyError, as_number
from im_pnt.netfile.schema.values import FilePart, Given, NotNegative, NumberWithin, Positive


class ConstantFile(FilePart):
    """Always the same."""

    value: NotNegative = Field(description="[s]")


class ExponentialFile(FilePart):
    """Without memory; rate [1/s] or mean [s]."""

    model_config = pydantic.ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    rate: Given[Annotated[float, Field(gt=0.0), BeforeValidator(as_number)]] = Field(None, description="[1/s]")
    mean: Given[Annotated[float, Field(gt=0.0), BeforeValidator(as_number)]] = Field(None, description="[s]")

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.rate is None) == (self.mean is None):
            raise ValueError("needs either rate [1/s] or mean [s]")
        for name, value in (("rate", self.rate), ("mean", self.mean)):
            if value is not None and not 1.0 / value < math.inf:
                raise FieldError((name,), f"{name} {value:g} is too small")
        return self


class UniformFile(FilePart):
    """Anything from low to high alike."""

    low: NotNegative = Field(description="[s]")
    high: Positive = Field(description="[s]")


class TriangularFile(FilePart):
    """From low to high, most often mode."""

    low: NotNegative = Field(description="[s]")
    high: Positive = Field(description="[s]")
    mode: NotNegative = Field(description="[s]")


class GammaFile(FilePart):
    """Mean shape times scale."""

    shape: Positive = Field(description="Shape, without unit.")
    scale: Positive = Field(description="[s]")


class WeibullFile(FilePart):
    """Times to failure."""

    scale: Positive = Field(description="[s]")
    shape: Positive = Field(description="Shape, without unit.")


class LognormalFile(FilePart):
    """Lognormal delay: the logarithm is normal with mean mu and deviation sigma."""

    mu: Annotated[float, NumberWithin()] = Field(description="Mean of the logarithm.")
    sigma: NotNegative = Field(description="Deviation of the logarithm.")


class DelayFile(FilePart):
    """One distribution of times [s]."""

    model_config = pydantic.ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})
    short_forms = ({"type": "number", "minimum": 0},)

    constant: Given[ConstantFile] = None
    exponential: Given[ExponentialFile] = None
    uniform: Given[UniformFile] = None
    triangular: Given[TriangularFile] = None
    gamma: Given[GammaFile] = None
    weibull: Given[WeibullFile] = None
    lognormal: Given[LognormalFile] = None

    @pydantic.model_validator(mode="before")
    @classmethod
    def _long(cls, value: object) -> object:
        if not isinstance(value, dict):
            return {"constant": {"value": value}}
        kinds = cls.model_fields.keys()
        if len(value) != 1:
            raise ValueError(f"names {len(value)} distributions; one of {', '.join(kinds)} is allowed")
        ((kind, parameters),) = value.items()
        if kind not in kinds:
            raise WrongKeyError((kind,), f"there is no distribution '{kind}'{nearest(kind, kinds)}")
        if not isinstance(parameters, dict):
            raise FieldError((kind,), f"is not a mapping with {', '.join(_delay_keys(kind))}")
        return value


def _delay_keys(kind: str) -> tuple[str, ...]:
    """Return the parameters of a distribution."""
    model = next(each for each in get_args(DelayFile.model_fields[kind].annotation) if each is not NoneType)
    return tuple(model.model_fields)
