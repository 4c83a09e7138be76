"""How many examples hypothesis tries: 12, under the profile `deep` of .ci/run 25, and of what is thorough 100."""

from hypothesis import settings

SHORT, DEEP, THOROUGH = 12, 25, 100


def most_of_what_is_thorough() -> int:
    """Return the number of examples for families of models and for safety under the profile that is in force."""
    return THOROUGH if settings.default.max_examples == DEEP else SHORT
