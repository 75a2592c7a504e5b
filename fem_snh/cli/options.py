"""The parser shared by all commands, the options of a scene, and values on the command line."""

from __future__ import annotations

import argparse
import json
import re
import textwrap
import tomllib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

from fem_snh.errors import BadInput, bad_value, is_number, unknown_name
from fem_snh.files import output_path

#: Settings of an option that may be repeated.
REPEATED: dict[str, Any] = {"action": "append", "default": []}


class Parser(argparse.ArgumentParser):
    """An argparse parser without abbreviations that raises `BadInput` instead of exiting.

    Parameters
    ----------
    command : str
        The command.
    description : str
        What the command does.
    options : str, optional
        The options, with their ``settings``: see `add`.
    epilog : callable, optional
        Returns the text after the options. It is called for the help only, so it may be slow.
    keys : iterable of str
        The keys that --set accepts.
    **settings : dict or callable
        See `add`.
    """

    def __init__(
        self,
        command: str,
        description: str,
        options: str = "",
        epilog: Callable[[], str] = lambda: "",
        keys: Iterable[str] = (),
        **settings: Any,
    ) -> None:
        super().__init__(
            prog=f"fem-snh {command}",
            description=description,
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        self._make_epilog, self._keys = epilog, set(keys)
        # argparse's own expression knows neither -1e-3 nor -inf.
        self._negative_number_matcher = re.compile(r"-(\d|\.\d|inf$|nan$)", re.IGNORECASE)
        if options:
            self.add(options, **settings)

    def add(self, text: str, **settings: Any) -> None:
        """Add the options of a text that lists them as the help does.

        Parameters
        ----------
        text : str
            ``--option PLACEHOLDER  help`` or ``name PLACEHOLDER  help`` for each; a line that is
            indented further continues the help. An option without a placeholder is a flag.
        **settings : dict or callable
            Further keywords of `argparse.ArgumentParser.add_argument` by the option's name, or
            only the keyword ``type``.
        """
        for entry in re.split(r"\n(?=\S)", textwrap.dedent(text).strip()):
            head, _, help = re.sub(r"\s*\n\s*", " ", entry).partition("  ")
            flag, _, placeholder = head.partition(" ")
            given = settings.pop(flag.removeprefix("--").replace("-", "_"), {})
            keywords = {"type": given} if callable(given) else dict(given)
            keywords |= {"metavar": placeholder} if placeholder else {"action": "store_true"}
            self.add_argument(flag, help=help.strip(), **keywords)
        assert not settings, settings

    def format_help(self) -> str:
        self.epilog = self._make_epilog()
        return super().format_help()

    def error(self, message: str) -> NoReturn:
        raise BadInput(f"{self.prog.split()[-1]}: {message.removeprefix('argument ')}")

    def parse(self, argv: list[str]) -> argparse.Namespace:
        """Parse ``argv``; the message for an unknown option names the nearest known one."""
        options = [name for name in self._option_string_actions if name.startswith("--")]
        args, rest = self.parse_known_args(argv)
        for word in [w for w in rest if w.startswith("-")] or rest:
            name = word.partition("=")[0]
            if word.startswith("-"):
                key = name.lstrip("-").replace("-", "_")
                if key in self._keys:
                    self.error(f"unknown option '{name}': expected --set {key}=..., a scene's key")
                self.error(
                    f"{unknown_name('option', name, sorted(options))}; PETSc options go after --"
                )
            known = "one scene at most" if "scene" in args else "one name at most"
            if all(action.option_strings for action in self._actions):
                known = f"{self.prog.split()[-1]} takes options alone"
            self.error(f"unexpected '{word}': {known}")
        return args


def output(text: str) -> Path:
    """Return the path of a folder or file to write; raise an argparse error for an empty text."""
    try:
        return output_path("path", text)
    except BadInput as error:  # argparse would not show the message of a ValueError
        raise argparse.ArgumentTypeError(str(error)) from None


def value(text: str, key: str = "value") -> Any:
    """Return the value that ``text`` has in a TOML file or in JSON; a bare word is a string.

    Parameters
    ----------
    text : str
        The value.
    key : str
        The key of the value, for the message.

    Raises
    ------
    BadInput
        For a text that begins a list or a table, and is neither TOML nor JSON.
    """
    with suppress(ValueError):  # no TOML, or a whole number of more than 4300 digits
        return tomllib.loads(f"value = {text}")["value"]
    if text.startswith(("[", "{")):
        try:
            return json.loads(text)
        except ValueError:
            accepted = "a list or a table in TOML or JSON, e.g. ['top'] or [{ group = 'top' }]"
            raise bad_value(key, text, accepted) from None
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    return float(text) if is_number(text) else text


def assignments(pairs: list[str]) -> dict[str, str]:
    """Return the values, as text, of the ``key=value`` pairs of --set, or raise BadInput."""
    values = {}
    for pair in pairs:
        key, equals, right = pair.partition("=")
        if not (equals and key.strip() and right.strip()):
            raise BadInput(f"--set {pair}: expected key=value, e.g. --set material.barrier=true")
        values[key.strip()] = right.strip()
    return values


def values_of(pairs: list[str]) -> dict[str, Any]:
    """Return the values of the ``key=value`` pairs of --set, or raise BadInput."""
    return {key: value(text, key) for key, text in assignments(pairs).items()}


def material_values(pairs: list[str]) -> dict[str, Any]:
    """Return `values_of` by keys of the material, which ``material.`` may precede as for run."""
    return {key.removeprefix("material."): given for key, given in values_of(pairs).items()}


def with_settings(
    options: Mapping[str, Any], settings: Mapping[str, Any], names: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return the keys of a scene that options and --set give; raise BadInput if both give one.

    Parameters
    ----------
    options : mapping
        The values of options by key; None if an option is not given.
    settings : mapping
        The values of --set by key.
    names : mapping, optional
        Names of options by key, where they differ.
    """
    given = {key: value for key, value in options.items() if value is not None}
    for key in given:
        if key in settings:
            option = (names or {}).get(key, key).replace("_", "-")
            raise BadInput(f"--{option} and --set {key}: expected one of them")
    return given | dict(settings)


def split_petsc(argv: list[str]) -> tuple[list[str], dict[str, str | None]]:
    """Return the words before ``--`` and the PETSc options after it.

    An option is ``-key value`` or a flag ``-key``, which has the value None.
    """
    if "--" not in argv:
        return argv, {}
    at = argv.index("--")
    options: dict[str, str | None] = {}
    key = ""
    for word in argv[at + 1 :]:
        if word.startswith("-") and not is_number(word):
            key = word.lstrip("-")
            options[key] = None
        elif key and options[key] is None:
            options[key] = word
        else:
            raise BadInput(f"'{word}' after --: expected PETSc options, e.g. -- -ksp_rtol 1e-6")
    return argv[:at], options
