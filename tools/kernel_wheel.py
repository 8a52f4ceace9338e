"""Makes the wheel for one platform of a pure wheel of uwserver: the same files, and all kernels compiled for each `LEVELS`.

    python tools/kernel_wheel.py dist/uwserver-1.2.3-py3-none-any.whl --python python3.11 --out dist

The kernels are compiled by that Python in a fresh environment, for CPUs of a named kind with an explicit list of what they can do, so nothing of the
building machine's CPU comes in; those that the user's cache has already, under the hash of all they are made of, are taken from there. They are good
for the very versions of numba and llvmlite that made them: the wheel pins both, and is for the platforms of numba's own wheel. Everything else of
the metadata stays.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from uwserver.physics.kernel import store

FINISHED = "uwserver/physics/kernel/finished"
"""Where the loader looks, as a path in the wheel."""
COMPILERS = ("numba", "llvmlite")
WARM = "uwserver.world.warm"
"""The module that compiles kernels."""
TIMEOUT_S = 1800.0
ASK = """
import json, platform
from importlib.metadata import distribution, version
from uwserver.physics.kernel.compiled import LEVELS
tags = [line.partition(": ")[2] for line in distribution("numba").read_text("WHEEL").splitlines() if line.startswith("Tag: ")]
print(json.dumps({"machine": platform.machine(), "levels": LEVELS, "tags": tags, "pins": {name: version(name) for name in %r}}))
"""
CHECK = """
from uwserver.physics.kernel.compiled import cache_state
from uwserver.world.builds import STAGES, missing
print("" if missing(STAGES) else cache_state.folder)
"""


class NotBuilt(Exception):
    """Why there is no wheel."""


def run(*command: str | Path, environment: Mapping[str, str], cwd: Path) -> str:
    """Output of a command that must succeed."""
    words = [str(word) for word in command]
    done = subprocess.run(
        words, env=dict(environment), cwd=cwd, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    if done.returncode != 0:
        raise NotBuilt(f"{' '.join(words)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def settings(level: str, features: Sequence[str]) -> dict[str, str]:
    """Environment variables by which numba compiles for a kind of CPU, whatever this machine has."""
    return {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": ",".join(f"+{feature}" for feature in features)}


def compile_kernels(python: Path, levels: Mapping[str, Sequence[str]], work: Path) -> dict[str, bytes]:
    """All kernels for each level, compiled by an environment's Python: the files of `FINISHED` by their paths in a wheel.

    Raises:
        NotBuilt: a kernel is missing, as where nothing solid is installed.
    """
    plain = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA_CPU"))}
    files: dict[str, bytes] = {}
    for level, features in levels.items():
        environment = plain | settings(level, features)
        run(python, "-m", WARM, environment=environment, cwd=work)
        folder = run(python, "-c", CHECK, environment=environment, cwd=work).strip()
        if not folder:
            raise NotBuilt(f"not all kernels were compiled for {level}: are the engines of solid things installed?")
        finished = work / FINISHED / f"{Path(folder).name.split('-')[1]}-{level}"
        finished.mkdir(parents=True)
        for path in sorted(Path(folder).glob("*.kernel")):
            body = store.read(path.parent, path.name)
            if body is None:
                raise NotBuilt(f"{path} is damaged")
            store.write(finished, path.name, body)
            files[f"{FINISHED}/{finished.name}/{path.name}"] = (finished / path.name).read_bytes()
    return files


def pinned(metadata: str, versions: Mapping[str, str]) -> str:
    """METADATA of a wheel that needs exactly these versions of what compiles kernels.

    Raises:
        NotBuilt: it does not name the first of them at all.
    """
    head, blank, text = metadata.partition("\n\n")
    lines = head.split("\n")
    first = next((i for i, line in enumerate(lines) if re.match(rf"Requires-Dist: {COMPILERS[0]}\b", line)), None)
    if first is None:
        raise NotBuilt(f"the wheel does not require {COMPILERS[0]}")
    lines[first : first + 1] = [f"Requires-Dist: {name}=={version}" for name, version in versions.items()]
    return "\n".join(lines) + blank + text


def file_name(pure: str, tags: Sequence[str]) -> str:
    """Of the wheel for these tags: ``uwserver-1.2.3-cp311-cp311-manylinux_2_28_x86_64.whl``."""
    distribution, version, *_ = pure.split("-")
    parts = zip(*(tag.split("-") for tag in tags), strict=True)
    return "-".join((distribution, version, *(".".join(dict.fromkeys(part)) for part in parts))) + ".whl"


def _record_line(path: str, data: bytes) -> str:
    digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
    return f"{path},sha256={digest},{len(data)}\n"


def assemble(pure: Path, added: Mapping[str, bytes], tags: Sequence[str], pins: Mapping[str, str], out: Path) -> Path:
    """A wheel for these tags with all files of a pure one and some more; returns its path.

    Args:
        pure: the wheel, ``py3-none-any``.
        added: files by their paths in the wheel.
        tags: as in a file WHEEL, ``cp311-cp311-manylinux_2_28_x86_64``.
        pins: versions of `COMPILERS`.
        out: folder.
    """
    target = out / file_name(pure.name, tags)
    with zipfile.ZipFile(pure) as source:
        files = {info.filename: source.read(info) for info in source.infolist()} | dict(added)
        date = source.infolist()[0].date_time
    (record,) = (path for path in files if path.endswith(".dist-info/RECORD"))
    folder = record.rpartition("/")[0]
    del files[record]
    files[f"{folder}/METADATA"] = pinned(files[f"{folder}/METADATA"].decode(), pins).encode()
    wheel = ["Wheel-Version: 1.0", "Generator: uwserver kernel_wheel", "Root-Is-Purelib: false"]
    files[f"{folder}/WHEEL"] = "".join(f"{line}\n" for line in (*wheel, *(f"Tag: {tag}" for tag in tags))).encode()
    ordered = sorted(files, key=lambda path: path.startswith(f"{folder}/"))  # a reader finds the metadata at the end
    files[record] = ("".join(_record_line(path, files[path]) for path in ordered) + f"{record},,\n").encode()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as wheel_file:
        for path in (*ordered, record):
            info = zipfile.ZipInfo(path, date)
            info.external_attr = 0o100644 << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            wheel_file.writestr(info, files[path])
    return target


def build(pure: Path, interpreter: str, out: Path) -> Path:
    """Compile with an interpreter, and put the wheel for it and this platform into a folder.

    Args:
        pure: beside it lies the wheel of uwclient, if the package index has none of that version.
        interpreter: a command or path.
        out: folder.

    Raises:
        NotBuilt: and why.
    """
    with tempfile.TemporaryDirectory(prefix="uwserver-kernels-") as name:
        work, environment = Path(name), dict(os.environ)
        run(interpreter, "-m", "venv", work / "venv", environment=environment, cwd=work)
        python = work / "venv" / "bin" / "python"
        wanted = f"{pure.resolve()}[solid]"
        install = (
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--find-links",
            pure.resolve().parent,
        )
        run(python, *install, wanted, environment=environment, cwd=work)
        facts = json.loads(run(python, "-I", "-c", ASK % (COMPILERS,), environment=environment, cwd=work))
        if facts["machine"] != "x86_64":
            raise NotBuilt(
                f"there are no kinds of CPU for {facts['machine']}: its kernels are compiled at the first start"
            )
        return assemble(pure, compile_kernels(python, facts["levels"], work), facts["tags"], facts["pins"], out)


def main() -> int:
    """Build one wheel."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path, help="the pure wheel")
    parser.add_argument("--python", default=sys.executable, help="the interpreter that it is for")
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder for the new wheel")
    options = parser.parse_args()
    try:
        wheel = build(options.wheel, options.python, options.out)
    except NotBuilt as error:
        print(f"no wheel: {error}", file=sys.stderr)
        return 1
    print(f"{wheel.name}: {wheel.stat().st_size // 1024} KiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
