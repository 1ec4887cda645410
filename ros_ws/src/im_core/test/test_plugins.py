"""What configuration names as ``module:Class`` is found, or the sentence says what is wrong with the name."""

import sys

import pytest

from im_core import plugins
from im_core.errors import ConfigError, ImError, LimitError


def test_classes_and_functions_are_found():
    assert plugins.load("im_core.errors:LimitError", ImError, "error") is LimitError
    assert plugins.load("im_core.plugins:load", None, "function") is plugins.load


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("nowhere:Law", "law 'nowhere:Law' cannot be loaded: No module named 'nowhere' .its folder belongs into PY"),
        ("im_core.errors:Nothing", "'im_core.errors:Nothing' cannot be loaded: .* no attribute 'Nothing'"),
        ("im_core.errors", "'im_core.errors' cannot be loaded: module or class is missing; it is written module:Class"),
        (":Law", "module or class is missing"),
        ("..errors:Law", "cannot be loaded: TypeError"),
        ("im_core.clock:monotonic", "law 'im_core.clock:monotonic' is no ImError"),
        ("builtins:int", "law 'builtins:int' is no ImError"),
    ],
)
def test_what_cannot_be_loaded_is_named(reference, message):
    with pytest.raises(ConfigError, match=message):
        plugins.load(reference, ImError, "law")


def test_where_a_function_will_do_that_is_said():
    with pytest.raises(ConfigError, match="no attribute 'grasp'; it is written module:Class or module:function"):
        plugins.load("im_core.plugins:grasp", None, "action function")


def test_a_module_that_was_changed_after_it_was_imported_is_told_apart(tmp_path, monkeypatch):
    file = tmp_path / "im_changing.py"
    file.write_text("law = dict\n")
    monkeypatch.syspath_prepend(tmp_path)
    plugins.require_current("im_changing:law", "law")
    assert plugins.load("im_changing:law", None, "law") is dict
    plugins.require_current("im_changing:law", "law")
    plugins.require_current("sys:exit", "law")
    file.write_text("law = list  # another one\n")
    with pytest.raises(ConfigError, match="im_changing was changed after this process imported it; restart"):
        plugins.require_current("im_changing:law", "law")


@pytest.mark.parametrize("error", ["RuntimeError", "SystemExit"])
def test_a_module_may_fail_in_any_way(tmp_path, monkeypatch, error):
    (tmp_path / "im_faulty.py").write_text(f"raise {error}('no hands')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ConfigError, match=f"im_faulty:Law' cannot be loaded: {error}: no hands"):
        plugins.load("im_faulty:Law", None, "law")


def test_a_module_beside_a_file_hides_no_library_and_is_told_where_a_library_hides_it(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(plugins, "_beside", [])
    for name in ("queue", "calendar", "gripping_of_a_test"):
        (tmp_path / f"{name}.py").write_text("def grip(): return 3\n")
    plugins.find_beside([tmp_path / "net.yaml"])
    assert sys.path[-1] == str(tmp_path)
    assert plugins.make("gripping_of_a_test:grip", "action function") == 3
    for name in ("queue", "calendar"):
        with pytest.raises(
            ConfigError, match=rf"{tmp_path}/{name}\.py is hidden by .*{name}\.py; give it another name"
        ):
            plugins.load(f"{name}:grip", None, "action function")
