"""`make site`: builds a site from the pages of the repository, with navigation and search. Needs the extra `site`.

The pages keep their paths in the repository, so that their links work in both places. Long reference pages are split at their
headings, one page for each subject. A broken link ends the build.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES, CONFIG = "build/site-pages", "build/mkdocs.yml"
SPLIT = ("docs/reference/scenario.md", "docs/reference/ports.md", "docs/reference/sensors/kinds.md")
"""Generated pages with many subjects, which the site splits."""
LINK = re.compile(r"(!?\[(?:[^\[\]]|\[[^\[\]]*\])*\]\()([^)\s]+)(\))")
FENCE = re.compile(r"^(```.*?^```[^\n]*$|~~~.*?^~~~$)", re.S | re.M)
HERO = (
    ("docs/images/examples/pipe.png", "A pipe followed by altimeter and scanning sonar", "examples/README.md"),
    ("docs/images/sensor_scanning_sonar.png", "Scanning sonar by the sonar equation", "docs/reference/sensors/scanning_sonar.md"),
    ("docs/images/qgroundcontrol_mission.png", "QGroundControl flies a mission", "docs/how-to/mavlink.md"),
    ("docs/images/demo_square.png", "A square by feedback on the sensors", "docs/tutorial.md"),
)  # fmt: skip
NAV: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "Start",
        (
            "README.md",
            "docs/how-to/install.md",
            "docs/tutorial.md",
            "docs/tutorial/*.md",
            "docs/scenarios.md",
            "docs/how-to/coming-from.md",
            "CHANGELOG.md",
            "ROADMAP.md",
        ),
    ),
    ("Examples", ("examples/README.md",)),
    ("How-to", ("docs/how-to/your-vehicle.md", "docs/how-to/*.md", "docs/how-to/*/*.md")),
    ("Clients", ("clients/*/README.md", "clients/*/*/README.md", "adapters/uwserver_adapters/*/README.md")),
    ("Vehicles", ("docs/vehicles.md", "docs/vehicles/*.md")),
    ("Sensors", ("docs/reference/sensors/*.md", "docs/reference/sensors/kinds/*.md")),
    ("Scenario files", ("docs/reference/scenario.md", "docs/reference/scenario/*.md")),
    ("Ports", ("docs/reference/ports.md", "docs/reference/ports/*.md")),
    ("Reference", ("docs/reference/*.md",)),
    (
        "How it works",
        (
            "docs/explanation/architecture.md",
            "docs/explanation/paths.md",
            "docs/explanation/words.md",
            "docs/explanation/*.md",
            "docs/validation.md",
            "CONTRIBUTING.md",
            "SECURITY.md",
        ),
    ),
)


def main() -> int:
    """Build the site; return 1 if a link is broken."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    stage(ROOT, ROOT / PAGES)
    config = {"INHERIT": str(ROOT / "mkdocs.yml"), "docs_dir": str(ROOT / PAGES), "site_dir": str(ROOT / "build/site"),
              "nav": navigation(ROOT / PAGES)}  # fmt: skip
    (ROOT / CONFIG).write_text(json.dumps(config, indent=1), encoding="utf-8")  # JSON is YAML
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--clean", "--config-file", CONFIG]
    done = subprocess.run(command, cwd=ROOT, check=False)
    if done.returncode == 0:
        print("wrote build/site/index.html")
    return done.returncode


def stage(root: Path, pages: Path) -> None:
    """Copy the pages and pictures that git holds, and the files that pages link to."""
    shutil.rmtree(pages, ignore_errors=True)
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=root, capture_output=True, text=True, check=True)  # fmt: skip
    files = {path for path in listed.stdout.splitlines() if (root / path).is_file()}
    texts = {path: (root / path).read_text(encoding="utf-8") for path in files if _is_page(path)}
    wanted = {path for path in files if path.startswith("docs/images/")}
    for path, text in texts.items():
        for _, target, _ in LINK.findall(text):
            found = _resolved(path, target.partition("#")[0])
            if found in files and found not in texts:
                wanted.add(found)
    moved = _split(texts)
    texts["README.md"] = _home(texts["README.md"])
    for path, text in texts.items():
        _write(pages / path, outside_code(text, lambda piece, path=path: _moved(path, piece, moved)))
    for path in wanted:
        (pages / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / path, pages / path)


def outside_code(text: str, change: Callable[[str], str]) -> str:
    """Return the text with `change` applied outside code blocks."""
    return "".join(piece if k % 2 else change(piece) for k, piece in enumerate(FENCE.split(text)))


def navigation(pages: Path) -> list[dict[str, list[str]]]:
    """Return the sections with their pages in the order of NAV, each page once."""
    seen: set[Path] = set()
    sections = []
    for title, patterns in NAV:
        found = [path for pattern in patterns for path in sorted(pages.glob(pattern)) if path not in seen]
        found = list(dict.fromkeys(found))
        seen.update(found)
        sections.append({title: [str(path.relative_to(pages)) for path in found]})
    return sections


def _is_page(path: str) -> bool:
    return path.endswith(".md") and (
        path.startswith(("docs/", "examples/", "clients/", "adapters/")) or "/" not in path
    )


def _home(text: str) -> str:
    """Put the pictures at the top of the README."""
    cells = [f"[![{title}]({picture})]({page})<br>[{title}]({page})" for picture, title, page in HERO]
    cards = f"| {cells[0]} | {cells[1]} |\n|---|---|\n| {cells[2]} | {cells[3]} |\n"
    title, rest = text.split("\n", 1)
    return f"{title}\n\n{cards}\n{rest}"


def _split(texts: dict[str, str]) -> dict[str, dict[str, str]]:
    """Split long pages; return for each of them the new page of each anchor."""
    moved: dict[str, dict[str, str]] = {}
    for path in SPLIT:
        head, *parts = re.split(r"^(?=## )", texts[path], flags=re.M)
        folder, anchors, lines = path.removesuffix(".md"), {}, []
        for part in parts:
            heading = part.split("\n", 1)[0].removeprefix("## ")
            page = f"{folder}/{_slug(heading) or 'part'}.md"
            # Headings go up by one; links are relative to the new place.
            body = outside_code(part, lambda piece: re.sub(r"^#(#+ )", r"\1", piece, flags=re.M))
            texts[page] = outside_code(body, partial(LINK.sub, partial(_deeper, path)))
            for title in re.findall(r"^#+ (.*)$", FENCE.sub("", part), re.M):
                anchors.setdefault(_slug(title), page)
            lines.append(f"- [{heading}]({Path(folder).name}/{Path(page).name})")
        texts[path] = head + "\n" + "\n".join(lines) + "\n"
        moved[path] = anchors
    return moved


def _deeper(page: str, link: re.Match[str]) -> str:
    """Rewrite a relative link of a page for a page one folder deeper."""
    target = link[2]
    if re.match(r"[a-z]+:", target):
        return link[0]
    return f"{link[1]}../{Path(page).name if target.startswith('#') else ''}{target}{link[3]}"


def _moved(path: str, text: str, moved: dict[str, dict[str, str]]) -> str:
    """Let links to an anchor of a split page lead to the page that has it now."""

    def other(found: re.Match[str]) -> str:
        target, _, anchor = found[2].partition("#")
        page = _resolved(path, target) if target else path
        part = moved.get(page, {}).get(anchor)
        if target and (ROOT / page).is_dir():  # a folder of the repository has no page
            return found[1].removesuffix("](").removeprefix("[")
        if part is None:
            return found[0]
        relative = Path(*[".."] * len(Path(path).parent.parts), part)
        return f"{found[1]}{relative}#{anchor}{found[3]}"

    return LINK.sub(other, text)


def _resolved(page: str, target: str) -> str:
    """Return the path in the repository of a relative link."""
    parts: list[str] = []
    for part in (*Path(page).parent.parts, *Path(target).parts):
        if part == ".." and parts:
            parts.pop()
        elif part != ".":
            parts.append(part)
    return "/".join(parts)


def _slug(title: str) -> str:
    """Return the anchor of a heading, as GitHub and the site make it."""
    plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).replace("`", "")
    return re.sub(r"[^\w\- ]", "", plain.strip().lower()).replace(" ", "-")


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
