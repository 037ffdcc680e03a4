"""Signatures of classes without an `__init__` of their own, from their fields, as equinox and NamedTuple make them."""

import griffe


class Fields(griffe.Extension):
    """Gives equinox modules and named tuples the `__init__` that they have when the program runs."""

    def on_class(self, *, cls: griffe.Class, **_) -> None:
        """Adds the parameters, in the order of the fields."""
        if "__init__" in cls.all_members or not cls.bases or "Protocol" in map(str, cls.bases):
            return
        # A class variable is no field of an instance, and neither is a property.
        fields = [a for a in cls.attributes.values() if "instance-attribute" in a.labels and a.annotation is not None]
        named = griffe.ParameterKind.positional_or_keyword
        parameters = [
            griffe.Parameter(f.name, annotation=f.annotation, kind=named, default=_default(f)) for f in fields
        ]
        if parameters:
            own = griffe.Parameter("self", kind=named)
            cls.set_member("__init__", griffe.Function("__init__", parameters=griffe.Parameters(own, *parameters)))


def _default(field: griffe.Attribute):
    """The default of a field: of `eqx.field(static=True, default=3)` it is 3."""
    if not isinstance(field.value, griffe.ExprCall):
        return field.value
    for argument in field.value.arguments:
        if getattr(argument, "name", "") == "default":
            return argument.value
        if getattr(argument, "name", "") == "default_factory":
            return f"{argument.value}()"
    return None if "field" in str(field.value.function) else field.value
