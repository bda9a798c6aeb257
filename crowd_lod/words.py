"""How figures read in sentences and tables."""


def number(value: float | None) -> str:
    """Three figures, and all of those before the point; "-" for None."""
    return "-" if value is None else f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
