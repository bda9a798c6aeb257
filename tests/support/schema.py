"""As much of JSON Schema (2020-12) as presets/schema.json uses."""

import re

KINDS = {"object": dict, "array": list, "string": str, "boolean": bool, "number": (int, float)}
NOTES = {"$schema", "$id", "$defs", "title", "description", "default", "examples", "$comment"}


def faults(value, schema, root=None, at="$"):
    """What is wrong with `value` by `schema`: a list of sentences."""
    root = root or schema
    found = []

    def inner(value, schema, at):
        return faults(value, schema, root, at)

    for word, rule in schema.items():
        if word in NOTES or word in ("then", "else"):
            continue
        if word == "$ref":
            assert rule.startswith("#/$defs/")
            found += inner(value, root["$defs"][rule.removeprefix("#/$defs/")], at)
        elif word == "type":
            if not isinstance(value, KINDS[rule]) or (rule == "number" and isinstance(value, bool)):
                return [*found, f"{at} is no {rule}"]
        elif word == "const":
            found += [f"{at} is not {rule}"] * (value != rule or isinstance(value, bool))
        elif word == "enum":
            found += [f"{at} is none of {rule}"] * (value not in rule)
        elif word == "oneOf":
            fits = sum(not inner(value, each, at) for each in rule)
            found += [f"{at} fits {fits} of {len(rule)} forms"] * (fits != 1)
        elif word == "not":
            found += [f"{at} is a form that is ruled out"] * (not inner(value, rule, at))
        elif word == "anyOf":
            found += [f"{at} fits none of {len(rule)} forms"] * all(
                inner(value, each, at) for each in rule
            )
        elif word == "if":
            found += inner(
                value, schema.get("then" if not inner(value, rule, at) else "else", {}), at
            )
        elif word == "required":
            found += [f"{at} lacks {name}" for name in rule if name not in value]
        elif word == "dependentRequired":
            found += [
                f"{at} lacks {n}"
                for key, names in rule.items()
                if key in value
                for n in names
                if n not in value
            ]
        elif word == "properties":
            found += [
                f
                for name, each in rule.items()
                if name in value
                for f in inner(value[name], each, f"{at}.{name}")
            ]
        elif word == "additionalProperties":
            for name in value.keys() - schema.get("properties", {}).keys():
                found += (
                    [f"{at} may not have {name}"]
                    if rule is False
                    else inner(value[name], rule, f"{at}.{name}")
                )
        elif word == "minProperties":
            found += [f"{at} has too few"] * (len(value) < rule)
        elif word == "maxProperties":
            found += [f"{at} has too many"] * (len(value) > rule)
        elif word == "items":
            found += [f for i, each in enumerate(value) for f in inner(each, rule, f"{at}[{i}]")]
        elif word == "minItems":
            found += [f"{at} is too short"] * (len(value) < rule)
        elif word == "maxItems":
            found += [f"{at} is too long"] * (len(value) > rule)
        elif word == "pattern":
            found += [f"{at} does not look like {rule}"] * (not re.search(rule, value))
        elif word == "minimum":
            found += [f"{at} is below {rule}"] * (value < rule)
        elif word == "exclusiveMinimum":
            found += [f"{at} is not above {rule}"] * (value <= rule)
        else:
            raise AssertionError(f"this validator does not know {word}")
    return found
