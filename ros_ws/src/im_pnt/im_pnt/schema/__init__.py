"""The JSON schema of net files, for editors."""

from importlib.resources import files


def schema_text() -> str:
    """Returns the schema as JSON text."""
    return files(__name__).joinpath("net.schema.json").read_text(encoding="utf-8")
