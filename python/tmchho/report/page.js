/* The few things of the page that move: light and dark, copying, printing. Without this file it can all be read. */
"use strict";
(() => {
  const page = document.documentElement, theme = document.querySelector("[data-theme-choice]");
  let kept = null;
  try { kept = localStorage.getItem("tmchho-theme"); } catch { /* a browser may keep nothing for files: then each visit begins anew */ }
  const choose = (name) => { page.dataset.theme = name; theme.value = name; };
  choose(["light", "dark"].includes(kept) ? kept : "auto");
  theme.addEventListener("change", () => {
    choose(theme.value);
    try { localStorage.setItem("tmchho-theme", theme.value); } catch { /* as above */ }
  });
  document.querySelector("[data-print]")?.addEventListener("click", () => print());
  document.querySelectorAll(".copied").forEach((box) => {
    const text = box.querySelector("pre"), button = Object.assign(document.createElement("button"), { type: "button", textContent: "Copy" });
    button.setAttribute("aria-label", `Copy ${box.dataset.what}`);
    button.addEventListener("click", async () => {
      try {
        await navigator.clipboard.writeText(text.textContent.trim());
        button.textContent = "Copied";
      } catch { // where the clipboard is closed to pages, the text is selected for the keys
        getSelection().selectAllChildren(text);
        button.textContent = "Press Ctrl+C";
      }
      setTimeout(() => { button.textContent = "Copy"; }, 2000);
    });
    box.append(button);
  });
})();
