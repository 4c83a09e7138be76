"""How many examples hypothesis tries: 25; 100 for safety and, under the profile `deep` of .ci/run, for families."""

from hypothesis import settings

EXAMPLES, THOROUGH = 25, 100
PROFILES = ("short", "deep")


def most_for_families() -> int:
    """Return the number of examples for families of models under the profile that is in force."""
    return THOROUGH if settings.get_current_profile_name() == "deep" else EXAMPLES
