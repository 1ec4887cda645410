"""Compile the Cython modules of the workspace, each beside its source; those whose source has not changed are left.

``.venv/bin/python scripts/compile_steps.py``; ``scripts/setup.sh`` runs it. Sums stay in the order of the source,
without fused multiply-add, for the least processor: a run is the same to the last digit on each.
"""

import hashlib
import importlib.machinery
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import Cython
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
SOURCES, BUILD = ROOT / "ros_ws" / "src", ROOT / "ros_ws" / "build" / "steps"
FLAGS = ["-O2", "-ffp-contract=off", "-fno-strict-aliasing", "-fPIC", "-shared", "-w"]
FLAGS += ["-DNPY_NO_DEPRECATED_API=NPY_1_22_API_VERSION"]
DIRECTIVES = "boundscheck=False,wraparound=False,cdivision=True"
SUFFIX = importlib.machinery.EXTENSION_SUFFIXES[0]


def main() -> int:
    """Compile what has changed; return the exit code."""
    sources = sorted(SOURCES.glob("im_*/im_*/**/*.pyx"))
    compiler = subprocess.run(["gcc", "--version"], capture_output=True, text=True, check=True).stdout
    common = [*FLAGS, DIRECTIVES, Cython.__version__, np.__version__, sys.version, compiler]
    for stale in set(SOURCES.glob(f"im_*/im_*/**/*{SUFFIX}")) - {target_of(source) for source in sources}:
        stale.unlink()
    for source in sources:
        key = hashlib.sha256("\0".join([*common, source.read_text("utf-8")]).encode()).hexdigest()
        compile_step(source, key)
    return 0


def target_of(source: Path) -> Path:
    """Return the compiled module of a source."""
    return source.with_name(source.stem + SUFFIX)


def compile_step(source: Path, key: str) -> None:
    """Compile one module, unless that of the same key is there.

    Raises:
        SystemExit: It does not compile; the message names the source, and has what the compiler said.
    """
    package, *folders, _ = source.relative_to(SOURCES).parts[1:]
    name = ".".join((package, *folders, source.stem))
    target, stamp = target_of(source), BUILD / f"{name}.key"
    if target.exists() and stamp.exists() and stamp.read_text("utf-8") == key:
        return
    BUILD.mkdir(parents=True, exist_ok=True)
    code, built = str(BUILD / f"{name}.c"), str(BUILD / f"{name}{SUFFIX}")
    include = [f"-I{folder}" for folder in (sysconfig.get_paths()["include"], np.get_include())]
    cython = [sys.executable, "-m", "cython", "-3", "-X", DIRECTIVES, "--module-name", name, "-o", code, str(source)]
    for command in (cython, ["gcc", *FLAGS, *include, code, "-o", built, "-lm"]):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"{source.relative_to(ROOT)} does not compile:\n{done.stdout}{done.stderr}")
    target.unlink(missing_ok=True)  # processes that run keep what they have loaded
    shutil.copyfile(built, target)
    stamp.write_text(key, "utf-8")
    print(f"compiled {source.relative_to(ROOT)}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
