"""The frame of every page: one HTML file that holds everything and may fetch nothing."""

from html import escape
from importlib.resources import files
from pathlib import Path

from clothtrack.files.atomic_write import whole_file

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; media-src data: blob:"
)


def write_document(path: Path, title: str, body: str, *, script: bool = True) -> Path:
    """Write a page with this body and return its path; without `script` nothing in it runs.

    Raises:
        StorageError: when the disk refuses; what was at `path` before is untouched then.
    """
    code = f"<script>{_resource('page_scene.js')}{_resource('page.js')}</script>" if script else ""
    page = f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)} · clothtrack</title>
<link rel="icon" href="data:,">
<style>{_resource("page.css")}</style>
</head>
<body>
<main>
<h1>{escape(title)}</h1>
{body}
</main>
{code}
</body>
</html>
"""
    with whole_file(Path(path)) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return Path(path)


def _resource(name: str) -> str:
    return files("clothtrack.report").joinpath(name).read_text(encoding="utf-8")
