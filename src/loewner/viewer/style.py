"""Style viser's panel: numbers that fit their boxes, legible labels, and the scene above the panel in a narrow window.

viser has no options for this, so the rules name the classes of viser's components. With another version of viser, rules
that do not apply have no effect.
"""

# Below this width, viser moves the panel to the bottom of the window, over the scene.
NARROW = "max-width: 36em"

# A vector of numbers and its label.
VECTOR = ".mantine-Flex-root:has(> div > .mantine-Flex-root > .mantine-NumberInput-root + .mantine-NumberInput-root)"

# A folder of check boxes.
BOXES = "div:has(> div > .mantine-Flex-root > div > .mantine-Checkbox-root)"

# The panel of a narrow window, and the window while this panel is open.
SHEET = '.mantine-Paper-root[style*="position: fixed"]'
OPEN = f'#root:has({SHEET} .mantine-ScrollArea-content > div > [aria-hidden="false"])'

HEAD = f"""
<script>
  if (matchMedia("(prefers-color-scheme: dark)").matches && !new URLSearchParams(location.search).has("darkMode"))
    history.replaceState(null, "", location.pathname + location.search + (location.search ? "&" : "?") + "darkMode");
  // Names for screen readers, where viser has none.
  const name = (element, text) => element.hasAttribute("aria-label") && element.ariaLabel || (element.ariaLabel = text);
  new MutationObserver(() => {{
    document.getElementById("root")?.setAttribute("role", "main");
    for (const label of document.querySelectorAll(".mantine-Text-root > label"))
      for (const field of label.closest(".mantine-Flex-root").querySelectorAll("input, [role=slider]"))
        name(field, label.innerText);
    for (const button of document.querySelectorAll(".mantine-ActionIcon-root")) name(button, "settings");
    for (const button of document.querySelectorAll(".mantine-CloseButton-root")) name(button, "close");
    for (const image of document.querySelectorAll("img:not([alt])")) image.alt = "";
  }}).observe(document, {{ childList: true, subtree: true }});
</script>
<style>
  [data-mantine-color-scheme="light"] {{ --mantine-color-dimmed: #495057 !important }}
  [data-mantine-color-scheme="dark"] {{ --mantine-color-dimmed: #b8b8b8 !important }}
  [data-mantine-color-scheme="light"] .mantine-Button-root {{ background: #1971c2 !important }}
  .mantine-Text-root:has(> label) {{ letter-spacing: normal !important }}
  {BOXES} {{ display: grid; grid-template-columns: 1fr 1fr }}
  {BOXES} > div {{ padding-right: 0 !important }}
  {BOXES} > div:not(:has(.mantine-Checkbox-root)) {{ grid-column: 1 / -1 }}
  {BOXES} .mantine-Flex-root {{ flex-direction: row-reverse; justify-content: flex-end; gap: 0.5em }}
  {BOXES} .mantine-Flex-root > div {{ width: auto !important; flex: none !important; padding: 0 !important }}
  .mantine-NumberInput-section {{ display: none !important }}
  .mantine-NumberInput-input {{
    padding: 0 0.4em !important; letter-spacing: -0.2px !important; text-align: right !important;
    font-variant-numeric: tabular-nums
  }}
  .mantine-Slider-root + .mantine-NumberInput-root {{ width: 5.5em !important; flex-shrink: 0 }}
  .mantine-Slider-root {{ align-self: center; padding-block: 0.4em !important }}
  {VECTOR} {{ display: block }}
  {VECTOR} > div:first-child {{ width: auto !important }}
  @media ({NARROW}) {{
    .mantine-Notification-description {{ display: none }}
    {SHEET} {{ width: 100% !important; max-height: 50% !important }}
    {SHEET} .mantine-ScrollArea-content > div {{ width: 100% !important }}
    {OPEN} [data-dock-root] {{ height: 50% !important }}
  }}
</style>"""
