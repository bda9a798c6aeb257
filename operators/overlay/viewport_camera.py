"""The viewport's own view as a Camera to plan with."""

import numpy as np

from ...crowd_lod.culling.camera import Camera, Window, referential


def viewpoint(context) -> Camera:
    """Return the view of the region being drawn as a Camera."""
    space = context.space_data
    view = context.region_data
    region = context.region
    camera = space.camera if space.use_local_camera else context.scene.camera
    through = view.view_perspective == "CAMERA" and camera is not None and camera.type == "CAMERA"
    clips = camera.data if through else space
    return camera_of(
        np.array(view.view_matrix, np.float64),
        np.array(view.window_matrix, np.float64),
        (region.width, region.height),
        (clips.clip_start, clips.clip_end),
    )


def camera_of(
    view: np.ndarray, projection: np.ndarray, pixels: tuple[int, int], clip: tuple[float, float]
) -> Camera:
    """Return the Camera that has these matrices.

    view: (4, 4) float64, world to viewer's space.
    projection: (4, 4) float64, OpenGL's, perspective or orthographic.
    pixels: width and height of the picture.
    clip: near and far in meters, of a perspective view, since far cannot be recovered from a
        float32 matrix. An orthographic view begins behind the viewer in Blender, so both of its
        are taken from the matrix.
    """
    origin, X, Y, Z = referential(np.linalg.inv(view), "of the viewport")
    edges = np.array([-1.0, 1.0])
    if projection[3, 3] == 0:
        kind = "PERSP"
        near, far = clip
        (left, right), (bottom, top) = (
            (edges + projection[axis, 2]) / projection[axis, axis] for axis in (0, 1)
        )
    else:
        kind = "ORTHO"
        near, far = (projection[2, 3] - edges) / projection[2, 2]
        (left, right), (bottom, top) = (
            (edges - projection[axis, 3]) / projection[axis, axis] for axis in (0, 1)
        )
    window = Window(float(left), float(right), float(bottom), float(top))
    return Camera(kind, origin, X, Y, Z, window, float(near), float(far), pixels)
