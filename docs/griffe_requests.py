"""Give functions in the Python reference the keywords and the help that they have from their requests at run time."""

from __future__ import annotations

import importlib
import inspect
import re
from typing import Any

import griffe


class RequestDocstrings(griffe.Extension):
    """Replace docstring and parameters of each function below a ``use_request`` by those of the imported function."""

    def on_function(self, *, func: griffe.Function, **others: Any) -> None:
        """Take over what a function has at run time; griffe calls this for each function that it has read."""
        if not any("use_request" in str(decorator.value) for decorator in func.decorators):
            return
        function = getattr(importlib.import_module(func.module.path), func.name)
        parameters = inspect.signature(function).parameters
        text = inspect.getdoc(function) or ""
        for name, parameter in parameters.items():
            if parameter.default not in (None, parameter.empty):  # the signature shows it
                text = re.sub(rf"^({name} : .*); default: .*$", r"\1", text, flags=re.M)
        func.docstring = griffe.Docstring(text, parent=func)
        func.parameters = griffe.Parameters(
            *(
                griffe.Parameter(
                    name,
                    annotation=str(parameter.annotation),
                    kind=griffe.ParameterKind[parameter.kind.name.lower()],
                    default=None if parameter.default is parameter.empty else repr(parameter.default),
                )
                for name, parameter in parameters.items()
            )
        )
