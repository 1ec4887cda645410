"""What the net ``pack`` reckons."""

from itertools import combinations

from im_core.errors import DataError


def choose(ctx):
    """Chooses the parts that fill the box best; tries all ways, which takes long where they are many."""
    masses, limit = ctx.command.arguments["masses"], ctx.command.arguments["limit"]
    best = []
    for count in range(1, len(masses) + 1):
        ctx.progress(f"sets of {count} parts", count / len(masses))
        for parts in combinations(range(len(masses)), count):
            if ctx.cancelled:
                raise DataError("cancelled while choosing", code="cancelled")
            if sum(masses[part] for part in best) < sum(masses[part] for part in parts) <= limit:
                best = list(parts)
    if not best:
        raise DataError(f"no part is as light as {limit} kg", limit=limit)
    ctx.result["parts"] = best
    ctx.result["mass"] = round(sum(masses[part] for part in best), 6)
