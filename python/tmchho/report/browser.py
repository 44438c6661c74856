"""A browser of this machine as a printer: whatever it shows, it also prints."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tmchho.errors import InvalidArgumentError, WriteError

_COMMANDS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
    "microsoft-edge",
    "brave-browser",
)
_PLACES = {
    "darwin": (
        "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
        "/Applications/Chromium.app/Contents/MacOS/Chromium",
        "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    ),
    "win32": (
        r"C:\Program Files\Google\Chrome\Application\chrome.exe",
        r"C:\Program Files (x86)\Google\Chrome\Application\chrome.exe",
        r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
        r"C:\Program Files\Microsoft\Edge\Application\msedge.exe",
    ),
}
_SECONDS = 120


def find_browser(required: bool = False) -> str | None:
    """Return the path of a browser that can print without a window, None where there is none.

    Parameters
    ----------
    required : bool
        Raise instead of returning None.

    Raises
    ------
    InvalidArgumentError
        If there is none and one is required.
    """
    found = next(filter(None, map(shutil.which, _COMMANDS)), None)
    found = found or next((path for path in _PLACES.get(sys.platform, ()) if Path(path).exists()), None)
    if found is None and required:
        raise InvalidArgumentError(
            "a PDF is printed by a browser, and neither Chromium, Chrome nor Edge was found; install one, or "
            "open report.html and print it"
        )
    return found


def print_to_pdf(browser: str, page: str, path: Path) -> None:
    """Print a page.

    Parameters
    ----------
    browser : str
        From `find_browser`.
    page : str
        HTML.
    path : Path
        The PDF to make.

    Raises
    ------
    WriteError
        If the browser does not make it.
    """
    with tempfile.TemporaryDirectory(prefix="tmchho-print-", ignore_cleanup_errors=True) as folder:
        html = Path(folder) / "report.html"
        html.write_text(page, encoding="utf-8")
        command = [
            browser,
            "--headless",
            "--disable-gpu",
            "--no-first-run",
            "--disable-extensions",
            "--disable-background-networking",
            f"--user-data-dir={Path(folder) / 'profile'}",
            "--no-pdf-header-footer",
            f"--print-to-pdf={path.absolute()}",
            html.as_uri(),
        ]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.insert(1, "--no-sandbox")  # which Chromium cannot have where the user is root
        try:
            done = subprocess.run(command, capture_output=True, timeout=_SECONDS, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise WriteError(
                f"{path}: {browser} could not print it ({error}); open {html.name} in a browser and print it"
            ) from error
    if done.returncode != 0 or not path.exists():
        last = done.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
        raise WriteError(
            f"{path}: {browser} did not print it ({' '.join(last) or done.returncode}); open {html.name} in "
            "a browser and print it"
        )
