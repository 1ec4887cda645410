"""Errors about what a file says that its model alone cannot judge."""

from pathlib import Path

import yaml

from im_core.config import field_name, line_of
from im_core.errors import ConfigError


def fault(path: Path, location: tuple[int | str, ...], sentence: str) -> ConfigError:
    """The error for a field of a file that could be read: names file, line and field."""
    node = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
    assert node is not None, "an empty file was refused before"
    line, field = line_of(node, location), field_name(location)
    return ConfigError(f"{path}:{line}: {field}: {sentence}", file=str(path), line=line, field=field)
