// For screen readers and keyboards: names of the sidebars, and code and tables that can be scrolled by keys.
function name(selector, label) {
  for (const part of document.querySelectorAll(selector)) part.setAttribute("aria-label", label);
}

function reach() {
  for (const part of document.querySelectorAll("pre, .table-wrapper"))
    if (part.scrollWidth > part.clientWidth) part.tabIndex = 0;
    else part.removeAttribute("tabindex");
}

addEventListener("DOMContentLoaded", () => {
  name(".sidebar-drawer", "Pages");
  name(".toc-drawer", "Sections of this page");
  reach();
});
addEventListener("resize", reach);
