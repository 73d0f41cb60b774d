"""HTML document of every page: one self-contained file that may fetch nothing."""

from html import escape
from importlib.resources import files
from pathlib import Path

from clothtrack.files.atomic_write import atomic_file

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; media-src data: blob:"
)

SCRIPTS = (
    "scene_math.js", "scene_shaders.js", "scene_cloth.js", "scene_view.js", "scene_parts.js",
    "scene.js", "page_scene.js", "page_review.js", "page.js",
)  # fmt: skip
"""Parts of the page's script in order; the last one starts everything."""


def document(title: str, body: str, *, script: bool = True) -> str:
    """Return a page with this body; without `script` it contains no code."""
    code = f"<script>{''.join(map(_resource, SCRIPTS))}</script>" if script else ""
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
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


def write_document(path: Path, title: str, body: str, *, script: bool = True) -> Path:
    """Write the page of `document` and return its path."""
    with atomic_file(Path(path)) as temporary:
        temporary.write_text(document(title, body, script=script), encoding="utf-8")
    return Path(path)


def served_document(page: str, version: int) -> str:
    """Return the page for a local server, with permission to request data from that server only."""
    code = f"<script>{_resource('page_live.js')}</script>"
    for plain, served in (
        (_POLICY, f"{_POLICY}; connect-src 'self'"),
        ("<body>", f'<body data-version="{version}">'),
        ("</body>", f"{code}\n</body>"),
    ):
        page = page.replace(plain, served, 1)
    return page


def _resource(name: str) -> str:
    return files("clothtrack.report").joinpath(name).read_text(encoding="utf-8")
