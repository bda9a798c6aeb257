/* A round point an agent. It is as wide as the agent's size makes it at its distance, within bounds in pixels. */
void main()
{
  gl_Position = matrix * vec4(position, 1.0);
  float across = diameter * pixels_per_meter / max(gl_Position.w, 1e-6);
  gl_PointSize = size * clamp(across, bounds.x, bounds.y);
  tint = color;
}
