import json

import jsonschema
import pytest

from im_pnt.cli import main
from im_pnt.delay import KINDS
from im_pnt.netfile import keys
from im_pnt.schema import schema_text

SCHEMA = json.loads(schema_text())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def properties(definition):
    return set(definition["properties"])


def test_the_schema_is_one_and_is_printed(capsys):
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == SCHEMA


def test_schema_and_reader_know_the_same_keys():
    definitions = SCHEMA["$defs"]
    place = definitions["place"]["anyOf"][2]
    transition = definitions["transition"]
    assert properties(SCHEMA) == set(keys.NET)
    assert properties(place) == set(keys.PLACE)
    assert properties(definitions["service"]) == set(keys.SERVICE)
    assert properties(transition) == set(keys.TRANSITION)
    assert properties(transition["properties"]["strategy"]) == set(keys.STRATEGY)
    for kind in ("service", "goal", "topic"):
        assert properties(transition["properties"][kind]) == set(keys.CALL[kind])
    assert properties(transition["properties"]["request"]["anyOf"][1]) == set(keys.CALL["request"])
    distributions = definitions["distribution"]["properties"]
    assert set(distributions) == set(keys.DELAY) == set(KINDS)
    for kind, parameters in keys.DELAY.items():
        assert properties(distributions[kind]) == set(parameters)
    assert properties(definitions["template"]) == set(keys.TEMPLATE)
    assert properties(definitions["use"]) == set(keys.USE)


def test_everything_that_an_author_can_write_is_explained():
    def explained(definition, where):
        if "$ref" in definition and "description" not in definition:
            definition = SCHEMA["$defs"][definition["$ref"].rsplit("/", 1)[1]]
        assert definition.get("description"), where
        for part in [definition, *definition.get("anyOf", [])]:
            for name, child in part.get("properties", {}).items():
                explained(child, f"{where}.{name}")

    explained(SCHEMA, "net")
    for name, definition in SCHEMA["$defs"].items():
        if name != "acts":
            explained(definition, name)


@pytest.mark.parametrize(
    "data", [{"net": "n", "odd": 1}, {"net": "9"}, {"places": {}}, {"net": "n", "places": {"SI": 1}}]
)
def test_the_schema_refuses(data):
    assert list(VALIDATOR.iter_errors(data))
