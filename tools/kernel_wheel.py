"""Makes the wheels for the platforms of a pure wheel of uwserver: the same files, and all kernels compiled for each kind of CPU in `LEVELS`.

    python tools/kernel_wheel.py dist/uwserver-1.2.3-py3-none-any.whl --python python3.11 --out dist

That Python compiles the kernels once, in a fresh environment, for CPUs of a named kind with an explicit list of what they can do, so nothing of the
building machine's CPU comes in (tools/emit_kernels.py). On x86-64 that gives the wheel for aarch64 too. Kernels that the user's cache has already,
under the hash of all they are made of, are taken from there. They are good for the very versions of numba and llvmlite that made them: the wheel pins
both, and is for the platforms of numba's own wheels. Everything else of the metadata stays.
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
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

FINISHED = "uwserver/physics/kernel/finished"
"""Where the loader looks, as a path in the wheel."""
COMPILERS = ("numba", "llvmlite")
EMIT = Path(__file__).with_name("emit_kernels.py")
TIMEOUT_S = 3600.0
ASK = """
import json, platform
from importlib.metadata import distribution, version
tags = [line.partition(": ")[2] for line in distribution("numba").read_text("WHEEL").splitlines() if line.startswith("Tag: ")]
print(json.dumps({"machine": platform.machine(), "tags": tags, "pins": {name: version(name) for name in %r}}))
"""
PLATFORMS = ("manylinux_2_28_", "manylinux_2_27_", "manylinux_2_17_", "manylinux2014_")
"""Of wheels of numba for another machine, the names up to the machine."""


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


def compile_kernels(python: Path, work: Path) -> dict[str, dict[str, bytes]]:
    """All kernels, compiled by an environment's Python: for each machine the files of `FINISHED` by their paths in a wheel.

    Raises:
        NotBuilt: a kernel is missing, as where nothing solid is installed.
    """
    plain = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA_"))}
    printed = run(python, "-I", EMIT, cache(), environment=plain, cwd=work)
    files: dict[str, dict[str, bytes]] = defaultdict(dict)
    for machine, _, folder in json.loads(printed.splitlines()[-1]):
        for path in sorted(Path(folder).glob("*.kernel")):
            files[machine][f"{FINISHED}/{path.parent.name}/{path.name}"] = path.read_bytes()
    return files


def cache() -> Path:
    """Where kernels of wheels are kept."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path("~/.cache").expanduser()) / "uwserver" / "wheels"


def tags_for(machine: str, python: Path, pins: Mapping[str, str], work: Path) -> list[str]:
    """Tags of numba's wheel for another machine and the same Python.

    Raises:
        NotBuilt: the package index has none of this version.
    """
    wanted = [f"{name}=={version}" for name, version in pins.items()]
    platforms = [word for name in PLATFORMS for word in ("--platform", f"{name}{machine}")]
    download = ("-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:", "--dest", work / machine)
    run(python, *download, *platforms, *wanted, environment=os.environ, cwd=work)
    (numba,) = (work / machine).glob("numba-*.whl")
    with zipfile.ZipFile(numba) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/WHEEL"))
        return tags_of(archive.read(name).decode().splitlines())


def tags_of(lines: Iterable[str]) -> list[str]:
    """Tags in the lines of a file WHEEL."""
    return [line.partition(": ")[2] for line in lines if line.startswith("Tag: ")]


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


def build(pure: Path, interpreter: str, out: Path) -> list[Path]:
    """Compile with an interpreter, and put the wheels for it into a folder: for this platform, and for others that can be served from here.

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
        install = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile")
        wanted = ("--find-links", pure.resolve().parent, f"{pure.resolve()}[solid]")
        run(python, *install, *wanted, environment=environment, cwd=work)
        facts = json.loads(run(python, "-I", "-c", ASK % (COMPILERS,), environment=environment, cwd=work))
        files = compile_kernels(python, work)
        if not files:
            raise NotBuilt(f"there are no kinds of CPU for {facts['machine']}: kernels are compiled at the first start")
        tags = {machine: tags_for(machine, python, facts["pins"], work) for machine in files if machine != facts["machine"]}  # fmt: skip
        tags[facts["machine"]] = facts["tags"]
        return [assemble(pure, files[machine], tags[machine], facts["pins"], out) for machine in sorted(files)]


def main() -> int:
    """Build the wheels of one Python."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path, help="the pure wheel")
    parser.add_argument("--python", default=sys.executable, help="the interpreter that it is for")
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder for the new wheel")
    options = parser.parse_args()
    try:
        made = build(options.wheel, options.python, options.out)
    except NotBuilt as error:
        print(f"no wheel: {error}", file=sys.stderr)
        return 1
    for wheel in made:
        print(f"{wheel.name}: {wheel.stat().st_size // 1024} KiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
