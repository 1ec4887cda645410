import json
from pathlib import Path

import jsonschema
import pytest

import im_pnt
from im_pnt.model.delay import KINDS
from im_pnt.netfile import schema_text
from im_pnt_analysis.cli import main

SCHEMA = json.loads(schema_text())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
FILE = Path(im_pnt.__file__).parent / "schema" / "net.schema.json"

KEYS = {
    "AssumptionFile": "at_most returns",
    "NetFile": "net description former escalate include parameters templates use places services at_once commands rest "
    "transitions assume interrupts",
    "InterruptFile": "during watch if do then says delay",
    "WatchedFile": "name type latched silent",
    "TemplateFile": "parameters ports arguments results places services commands rest transitions",
    "PortsFile": "in out on_failure",
    "UseFile": "template for with",
    "PlaceFile": "title tokens capacity data_object on_invalid remote resource",
    "ObjectFile": "name type scope",
    "ServiceFile": "entry done failed arguments acts_on",
    "CommandFile": "description arguments needs busy priority",
    "ArgumentFile": "type unit minimum maximum choices length default help",
    "TransitionFile": "title use arguments with "
    "in out inhibitors resets guard symbol emit action service goal topic await request result "
    "store acts_on says on_failure on_doubt timeout tries retry_of delay success weight strategy priority "
    "servers cancels keeps_failure",
    "SymbolFile": "name of expires",
    "StrategyFile": "successes failures name context decay",
    "ServiceCallFile": "name type request build handle task",
    "GoalFile": "name type goal build handle task",
    "TopicFile": "name type message build",
    "AwaitFile": "name type latched until handle silent",
    "RequestFile": "to arguments build",
    "ConstantFile": "value",
    "ExponentialFile": "rate mean",
    "UniformFile": "low high",
    "TriangularFile": "low high mode",
    "GammaFile": "shape scale",
    "WeibullFile": "scale shape",
    "LognormalFile": "mu sigma",
}
"""What net files may say; DelayFile has a key for each distribution."""


def definition(name):
    """The mapping that a definition allows, among other things."""
    whole = SCHEMA if name == "NetFile" else SCHEMA["$defs"][name]
    return next(part for part in [whole, *whole.get("anyOf", [])] if "properties" in part)


def test_the_schema_is_one_and_is_printed(capsys):
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == SCHEMA


def test_the_file_that_editors_read_is_the_one_that_the_models_make():
    renew = "scripts/im pnt schema > ros_ws/src/im_pnt/im_pnt/schema/net.schema.json"
    assert FILE.read_text(encoding="utf-8") == schema_text(), f"stale; renew it: {renew}"


def test_the_schema_knows_the_keys_of_net_files():
    for name, keys in KEYS.items():
        assert set(definition(name)["properties"]) == set(keys.split()), name
    assert set(definition("DelayFile")["properties"]) == set(KINDS)
    assert set(SCHEMA["$defs"]) == {*KEYS, "DelayFile"} - {"NetFile"}


def test_everything_that_an_author_can_write_is_explained():
    def explained(definition, where):
        if "$ref" in definition and "description" not in definition:
            definition = SCHEMA["$defs"][definition["$ref"].rsplit("/", 1)[1]]
        assert definition.get("description"), where
        for part in [definition, *definition.get("anyOf", [])]:
            for name, child in part.get("properties", {}).items():
                explained(child, f"{where}.{name}")

    explained(SCHEMA, "net")
    for name, each in SCHEMA["$defs"].items():
        explained(each, name)


@pytest.mark.parametrize(
    "data",
    [{"net": "n", "odd": 1}, {"net": "9"}, {"places": {}}, {"net": "n", "places": {"SI": 1}}]
    + [{"net": "n", "assume": {"a": assumed}} for assumed in (None, {}, {"at_most": 1, "returns": "other.a"})],
)
def test_the_schema_refuses(data):
    assert list(VALIDATOR.iter_errors(data))
