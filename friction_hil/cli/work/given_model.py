"""The model that an argument of a command names."""

from dataclasses import replace

from friction_hil.errors import ConfigurationError, UsageError
from friction_hil.models.files import model_from_argument
from friction_hil.models.model_file import ModelFile

_OPTION = "--model "  # prefix of the messages about a model that an option names


def given_model(argument: str) -> ModelFile:
    """Return the model of an argument that is not the option ``--model``; see `model_from_argument`.

    Raises `ConfigurationError` or `UsageError` as that does, without the name of the option.
    """
    try:
        return model_from_argument(argument)
    except ConfigurationError as error:
        problems = [replace(each, path=each.path.removeprefix(_OPTION)) for each in error.problems]
        raise ConfigurationError(problems) from None
    except UsageError as error:
        raise UsageError(str(error).removeprefix(_OPTION)) from None
