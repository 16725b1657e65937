"""Pages of the documentation that no clone has, because the build of the site makes them; and pages."""

from pathlib import Path

# Below docs/, without their endings; git ignores them.
MADE_BY_THE_BUILD = {"measured", "reference/command"}


def pages(docs: Path) -> list[Path]:
    """Markdown files of the documentation, without the copies in a site that was built."""
    return sorted(page for page in docs.rglob("*.md") if "_build" not in page.relative_to(docs).parts)
