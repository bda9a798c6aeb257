/* Shared by all shaders of meshes: data in textures, the skinning of crowd_lod/animation.py, the dither. */

/* An affine matrix as three rows. */
struct Rows {
  vec4 x, y, z;
};

Rows scaled(Rows m, float factor)
{
  return Rows(m.x * factor, m.y * factor, m.z * factor);
}

Rows added(Rows a, Rows b)
{
  return Rows(a.x + b.x, a.y + b.y, a.z + b.z);
}

vec3 turned(Rows m, vec3 direction)
{
  return vec3(dot(m.x.xyz, direction), dot(m.y.xyz, direction), dot(m.z.xyz, direction));
}

vec3 moved(Rows m, vec3 point)
{
  return turned(m, point) + vec3(m.x.w, m.y.w, m.z.w);
}

#ifdef SKINNED
Rows joint(int frame, int number)
{
  ivec2 at = ivec2(3 * number, frame);
  return Rows(texelFetch(joint_frames, at, 0), texelFetch(joint_frames, at + ivec2(1, 0), 0),
              texelFetch(joint_frames, at + ivec2(2, 0), 0));
}

/* The vertex's matrix to the character's space at `phase`: two frames mixed linearly, joints blended by weight. Weights
 * fall, so the first zero ends them. */
Rows skinned(float phase, uvec4 joints, vec4 weights)
{
  float at = phase * float(frame_count - 1);
  int first = clamp(int(at), 0, max(frame_count - 2, 0));
  int second = min(first + 1, frame_count - 1);
  float part = at - float(first);
  Rows sum = Rows(vec4(0.0), vec4(0.0), vec4(0.0));
  for (int i = 0; i < 4; i++) {
    if (weights[i] == 0.0) {
      break;
    }
    int number = int(joints[i]);
    sum = added(sum, scaled(joint(first, number), weights[i] * (1.0 - part)));
    sum = added(sum, scaled(joint(second, number), weights[i] * part));
  }
  return sum;
}
#endif

/* An instance: two texels of a texture that is TEXELS wide. */
struct Agent {
  vec3 feet; /* relative to the drawing's origin */
  float phase;
  int colour; /* in the palette */
  float share; /* > 0: drawn where the dither is below it; < 0: where it is not below -share; 0: everywhere */
  vec3 x_axis, y_axis, z_axis; /* of the character, in the world */
};

Agent agent(int number)
{
  ivec2 at = ivec2(2 * number % TEXELS, 2 * number / TEXELS);
  vec4 one = texelFetch(agents, at, 0), two = texelFetch(agents, at + ivec2(1, 0), 0);
  Agent a;
  a.feet = one.xyz;
  a.phase = two.x;
  a.colour = int(two.y) / 4;
  a.share = two.y - float(4 * a.colour) - 2.0;
  /* Rz(heading) Ry(-pitch) Rx(roll) Rz(turn) */
  float c = cos(one.w), s = sin(one.w);
  vec3 ahead = vec3(c, s, 0.0), left = vec3(-s, c, 0.0), up = vec3(0.0, 0.0, 1.0);
  if (two.z != 0.0 || two.w != 0.0) {
    ahead = vec3(c * cos(two.z), s * cos(two.z), sin(two.z));
    vec3 level_up = cross(ahead, left);
    up = cos(two.w) * level_up - sin(two.w) * left;
    left = cos(two.w) * left + sin(two.w) * level_up;
  }
  a.x_axis = view.turn.x * ahead + view.turn.y * left;
  a.y_axis = view.turn.x * left - view.turn.y * ahead;
  a.z_axis = up;
  return a;
}

vec3 oriented(Agent a, vec3 v)
{
  return a.x_axis * v.x + a.y_axis * v.y + a.z_axis * v.z;
}
