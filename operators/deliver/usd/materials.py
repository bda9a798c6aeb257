"""Materials of a USD file: UsdPreviewSurface by the base color, or the image behind it."""

import os
from pathlib import Path
from typing import Any

import bpy

from ....crowd_lod.output.file_checks import save_png
from ...blender import image_data
from ...blender.colors import Looks
from ...blender.materials import shader_of

# endings of image files that every USD reader knows (OpenUSD's compliance checker)
READ_BY_ALL = (".png", ".jpg", ".jpeg", ".exr")


class Materials:
    """Writes each material once.

    usd: of openusd.openusd. stage: the open stage. home: the path of its materials in it.
    place: where the file will be; hidden: where it is until then. Images in no file of their own
        are written beside it.
    """

    def __init__(self, usd, stage, home: str, place: Path, hidden: Path):
        self.usd = usd
        self.stage = stage
        self.home = home
        self.place = place
        self.hidden = hidden
        self._looks = Looks()
        self._made = {}
        self._files = {}

    def of(self, material: bpy.types.Material | None) -> Any:
        """Return the UsdShade.Material of `material`."""
        if material not in self._made:
            self._made[material] = self._write(material)
        return self._made[material]

    def _write(self, material: bpy.types.Material | None) -> Any:
        shade = self.usd.UsdShade
        types = self.usd.Sdf.ValueTypeNames
        path = f"{self.home}/{self.name(material.name if material else 'Gray')}"
        usd_material = shade.Material.Define(self.stage, path)
        surface = shade.Shader.Define(self.stage, f"{path}/Surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        usd_material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
        *color, layer = self._looks.of(material)
        base = surface.CreateInput("diffuseColor", types.Color3f)
        file = self._file(self._looks.sources[int(layer)]) if layer >= 0 else ""
        if file:
            reader, image = (
                shade.Shader.Define(self.stage, f"{path}/{each}") for each in ("UV", "Image")
            )
            reader.CreateIdAttr("UsdPrimvarReader_float2")
            reader.CreateInput("varname", types.String).Set("st")
            image.CreateIdAttr("UsdUVTexture")
            image.CreateInput("file", types.Asset).Set(file)
            image.CreateInput("st", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
            for axis in "ST":
                image.CreateInput(f"wrap{axis}", types.Token).Set("repeat")
            reader.CreateOutput("result", types.Float2)
            image.CreateOutput("rgb", types.Float3)
            base.ConnectToSource(image.ConnectableAPI(), "rgb")
        else:
            base.Set(self.usd.Gf.Vec3f(*map(float, color)))
        for name, value in _shine(material).items():
            surface.CreateInput(name, types.Float).Set(value)
        return usd_material

    def name(self, name: str) -> str:
        """Return a name for a material that USD takes, and that no other has."""
        valid = self.usd.Tf.MakeValidIdentifier(name)
        while self.stage.GetPrimAtPath(f"{self.home}/{valid}"):
            valid += "_"
        return valid

    def _file(self, image: bpy.types.Image) -> str:
        """Return the path that the USD file has of the image's file; write one if it has none."""
        if image not in self._files:
            path = Path(bpy.path.abspath(image.filepath, library=image.library))
            is_named = (
                image.source == "FILE"
                and not image.packed_file
                and not image.is_dirty
                and path.is_file()
            )
            self._files[image] = (
                self._relative_path(path)
                if is_named and path.suffix.lower() in READ_BY_ALL
                else self._saved(image)
            )
        return self._files[image]

    def _relative_path(self, file: Path) -> str:
        try:
            return f"./{Path(os.path.relpath(file, self.place.parent)).as_posix()}"
        except ValueError:  # on another drive
            return file.as_posix()

    def _saved(self, image: bpy.types.Image) -> str:
        name = (
            f"{self.place.stem}_{bpy.path.clean_name(Path(image.name).stem)}_{len(self._files)}.png"
        )
        save_png(self.hidden / name, image_data.read_pixels(image))
        return f"./{name}"


def _shine(material: bpy.types.Material | None) -> dict[str, float]:
    """Return roughness and metallic of the material's shader, where it has them as numbers."""
    node = shader_of(material) if material is not None else None
    sockets = (
        {name.lower(): node.inputs.get(name) for name in ("Roughness", "Metallic")}
        if node is not None
        else {}
    )
    return {
        name: float(each.default_value)
        for name, each in sockets.items()
        if each is not None and not each.is_linked
    }
