"""What is wrong with a scene file in TOML, in the words of its keys."""

import difflib
from typing import Any, get_args

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from fibercontact.simulation import scene_schema as schema

__all__ = ["in_words", "known_keys"]


def in_words(error: ErrorDetails, table: dict[str, Any]) -> str:
    """A fault of a key, as `key: what is wrong`."""
    key = _key(error["loc"], table)
    match error["type"]:
        case "extra_forbidden":
            near = difflib.get_close_matches(str(error["loc"][-1]), sorted(known_keys()), n=1)
            return f"{key}: no such key" + (f" (did you mean {near[0]}?)" if near else "")
        case "missing":
            return f"{key}: is missing"
        case "union_tag_not_found":
            return f"{key}: needs the key {error['ctx']['discriminator'].strip(chr(39))}"
        case "union_tag_invalid":
            what = error["ctx"]["discriminator"].strip("'")
            return (
                f"{key}.{what}: must be one of {error['ctx']['expected_tags']}, not {error['ctx']['tag']!r}"
            )
        case "list_type" if isinstance(error["input"], dict):
            return f"{key}: is a list of tables: write [[{key}]]"
        case _:
            text = error["msg"].removeprefix("Value error, ").removeprefix("Input ")
            return f"{key}: {text[0].lower()}{text[1:]}" + _given(error["input"])


def _given(value: Any) -> str:
    return f" (it is {value!r})" if isinstance(value, (str, int, float)) else ""


def _key(path: tuple[str | int, ...], table: Any) -> str:
    """The key that a path leads to; what is not in the table, but for the end, is a choice of the schema's."""
    key = ""
    for place, step in enumerate(path):
        if isinstance(step, int):
            key += f"[{step}]"
            table = table[step] if isinstance(table, list) and step < len(table) else None
        elif isinstance(table, dict) and (step in table or place == len(path) - 1):
            key += f".{step}"
            table = table.get(step)
    return key.removeprefix(".")


def known_keys() -> set[str]:
    """Every key that some table may have."""
    tables = [schema.SceneFile, schema.Fibres, schema.Body, schema.Stage, schema.AirTable]
    for union in (schema.Place, schema.Obstacle):
        tables += get_args(get_args(union)[0])
    return {key for table in tables if issubclass(table, BaseModel) for key in table.model_fields}
