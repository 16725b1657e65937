"""Pages of the documentation that no clone has, because the build of the site makes them."""

# Below docs/, without their endings; git ignores them.
MADE_BY_THE_BUILD = {"measured", "reference/command"}
