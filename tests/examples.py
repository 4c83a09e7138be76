"""How many examples hypothesis tries: 12; under the profile `deep` of .ci/run, 100 of what is thorough."""

from hypothesis import settings

EXAMPLES, THOROUGH = 12, 100
PROFILES = ("short", "deep")


def most_of_what_is_thorough() -> int:
    """Return the number of examples for families of models and for safety under the profile that is in force."""
    return THOROUGH if settings.get_current_profile_name() == "deep" else EXAMPLES
