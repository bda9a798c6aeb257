"""Sphere against frustum in exact rational arithmetic: no code, and no rounding, in common with the culling."""

from fractions import Fraction as F


def dot(a, b):
    return sum((F(float(p)) * F(float(q)) for p, q in zip(a, b, strict=True)), F(0))


def sees(camera, centre, radius):
    """Whether the sphere (centre (3,) floats in world metres, radius) lies in or touches all six planes, exactly."""
    v = [F(float(p)) - F(float(c)) for p, c in zip(centre, camera.origin, strict=True)]
    right, up, depth = (sum((p * F(float(q)) for p, q in zip(v, axis, strict=True)), F(0)) for axis in (camera.X, camera.Y, camera.Z))
    r, near, far = F(float(radius)), F(float(camera.near)), F(float(camera.far))
    if depth < near - r or depth > far + r:
        return False
    w = camera.window
    for across, edge in ((right, w.right), (-right, -w.left), (up, w.top), (-up, -w.bottom)):
        t = F(float(edge))
        if camera.kind == "ORTHO":
            if across - t > r:
                return False
        else:
            # (across - depth t) / sqrt(1 + t^2) <= r, without the root
            out = across - depth * t
            if out > 0 and out * out > r * r * (1 + t * t):
                return False
    return True
