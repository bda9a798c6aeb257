"""What panels draw: their properties and buttons, noted as they are drawn."""

import bpy


class Noting:
    """A layout that passes everything on to Blender's, and notes settings and buttons.

    buttons: (name, properties) of each; Blender has read these once the panel is drawn.
    """

    def __init__(self, layout, settings: list, buttons: list):
        vars(self).update(_layout=layout, _settings=settings, _buttons=buttons)

    def __setattr__(self, name: str, value):
        setattr(self._layout, name, value)

    def __getattr__(self, name: str):
        found = getattr(self._layout, name)
        if not callable(found):
            return found

        def call(*words, **options):
            result = found(*words, **options)
            if name in ("prop", "prop_search", "template_ID"):
                self._settings.append(f"{words[0].rna_type.identifier}.{words[1]}")
            if name == "operator":
                self._buttons.append((words[0], result))
            if isinstance(result, bpy.types.UILayout):
                return Noting(result, self._settings, self._buttons)
            return result

        return call


class _Panel:
    """A panel that draws on another layout."""

    def __init__(self, panel, layout):
        self._panel = panel
        self.layout = layout

    def __getattr__(self, name: str):
        return getattr(self._panel, name)


def note(kinds, drawn: dict):
    """Let each drawing of these panels note in `drawn`, by panel, its settings and buttons.

    A button is the name of its operator with the properties that were set.
    """
    for kind in kinds:
        for name in ("draw", "draw_header", "draw_header_preset"):
            if hasattr(kind, name):
                setattr(kind, name, _noting(kind, name, drawn))


def _noting(kind, name: str, drawn: dict):
    draw = getattr(kind, name)

    def noted(panel, context):
        settings, buttons = [], []
        draw(_Panel(panel, Noting(panel.layout, settings, buttons)), context)
        named = [
            f"{operator}({', '.join(f'{key}={value!r}' for key, value in options.items())})"
            for operator, options in buttons
        ]
        drawn[kind.__name__, name] = settings, named

    return noted
