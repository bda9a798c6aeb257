/* A round point for an agent, as wide as the agent is at its distance, within bounds in pixels. */
void main()
{
  gl_Position = matrix * vec4(position, 1.0);
  float across = diameter * pixels_per_meter / max(gl_Position.w, 1e-6);
  gl_PointSize = size * clamp(across, bounds.x, bounds.y);
  tint = color;
}
