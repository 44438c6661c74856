"""How soon a report shows its 3D view, and how smoothly that turns: in a Chromium without a window.

    python benches/view_report.py out/demo/report.html [--gpu]

Without `--gpu` the processor draws, by SwiftShader, as on a machine without a graphics card.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

from tmchho.report.browser import find_browser

# Turns the view at every frame, and tells how long each frame took and how many points it had.
TURN = """n => new Promise(done => {
  const viewer = document.querySelector('.viewer').viewer, times = [], shares = [];
  const step = now => {
    times.push(now);
    shares.push(viewer.share());
    viewer.orbit(0.05, 0);
    if (times.length <= n) requestAnimationFrame(step);
    else done({seconds: times.slice(1).map((t, i) => (t - times[i]) / 1000), shares});
  };
  requestAnimationFrame(step);
})"""
WHOLE = """() => { // all points, and wait until they are drawn
  const viewer = document.querySelector('.viewer').viewer;
  const gl = document.querySelector('canvas').getContext('webgl2');
  const began = performance.now();
  viewer.draw();
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  return performance.now() - began;
}"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--gpu", action="store_true", help="let the browser use the graphics card")
    parser.add_argument("--frames", type=int, default=120)
    asked = parser.parse_args()
    arguments = [] if asked.gpu else ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        arguments.append("--no-sandbox")
    print(f"{asked.page}: {asked.page.stat().st_size / 1e6:.1f} MB, {os.cpu_count()} cores")
    print(f"load before: {os.getloadavg()[0]:.1f}")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=find_browser(required=True), headless=True, args=arguments
        )
        # The page's own rules forbid what the driver does to wait; they are not what is measured.
        page = browser.new_page(viewport={"width": 1280, "height": 900}, bypass_csp=True)
        began = time.perf_counter()
        page.goto(asked.page.absolute().as_uri(), wait_until="load", timeout=240_000)
        loaded = time.perf_counter() - began
        page.wait_for_function("performance.getEntriesByName('first-contentful-paint').length")
        paint, view = page.evaluate(
            "() => [performance.getEntriesByName('first-contentful-paint')[0].startTime / 1000,"
            "performance.getEntriesByName('tmchho-first-draw')[0].startTime / 1000]"
        )
        print(f"first paint {paint:.2f} s, first draw of the 3D view {view:.2f} s, loaded {loaded:.2f} s")
        page.locator("canvas").scroll_into_view_if_needed()
        whole = sorted(page.evaluate(WHOLE) for _ in range(5))[2]
        print(f"all points: {whole:.0f} ms a frame (median of 5)")
        turned = page.evaluate(TURN, asked.frames)
        seconds = sorted(turned["seconds"][5:])
        print(
            f"turning: {len(seconds) / sum(seconds):.1f} frames a second, slowest of 20 frames"
            f" {1000 * seconds[int(0.95 * len(seconds))]:.0f} ms, {min(turned['shares']):.0%} to"
            f" {max(turned['shares']):.0%} of the points"
        )
        browser.close()


if __name__ == "__main__":
    main()
