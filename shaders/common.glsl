/* Shared by all shaders of meshes: data in textures, and the skinning of
 * crowd_lod/animation/skinning.py. */

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

/* A direction packed into a float, and unpacked: octahedral, 12 bits along each axis, exact to 1 in
 * 2,000. Source: Cigolle et al., "Survey of efficient representations for independent unit
 * vectors", 2014. */
const float STEPS = 4095.0;

float coded(vec3 direction)
{
  vec3 n = direction / max(abs(direction.x) + abs(direction.y) + abs(direction.z), 1e-20);
  vec2 side = vec2(n.x < 0.0 ? -1.0 : 1.0, n.y < 0.0 ? -1.0 : 1.0);
  vec2 plane = n.z < 0.0 ? (1.0 - abs(n.yx)) * side : n.xy;
  vec2 whole = round((0.5 + 0.5 * plane) * STEPS);
  return whole.x * (STEPS + 1.0) + whole.y;
}

vec3 decoded(float code)
{
  float x = floor(code / (STEPS + 1.0));
  vec2 plane = vec2(x, code - x * (STEPS + 1.0)) * (2.0 / STEPS) - 1.0;
  float z = 1.0 - abs(plane.x) - abs(plane.y);
  vec2 fold = vec2(max(-z, 0.0));
  return vec3(plane - fold * vec2(plane.x < 0.0 ? -1.0 : 1.0, plane.y < 0.0 ? -1.0 : 1.0), z);
}

/* A vertex in the character's space. */
struct Posed {
  vec3 at, facing;
};

#ifdef JOINTS
Rows joint(int frame, int number)
{
  ivec2 at = ivec2(3 * number, frame);
  return Rows(texelFetch(joint_frames, at, 0), texelFetch(joint_frames, at + ivec2(1, 0), 0),
              texelFetch(joint_frames, at + ivec2(2, 0), 0));
}

/* The vertex at a frame of the action: its joints' matrices, weighed and added. The weights come
 * largest first, so the first zero ends them. */
Posed posed(int frame)
{
  Rows sum = Rows(vec4(0.0), vec4(0.0), vec4(0.0));
  for (int i = 0; i < 4; i++) {
    if (weights[i] == 0.0) {
      break;
    }
    sum = added(sum, scaled(joint(frame, int(joints[i])), weights[i]));
  }
  return Posed(moved(sum, position), turned(sum, normal));
}
#endif

#ifdef FRAMES
/* The vertex at a frame of the action, as skin.vert.glsl has written it. */
Posed posed(int frame)
{
  vec4 texel = texelFetch(skinned_frames, ivec2(gl_VertexID, frame), 0);
  return Posed(texel.xyz, decoded(texel.w));
}
#endif

#ifdef INSTANCES
/* An instance: three texels of a texture that is TEXELS wide. */
struct Agent {
  vec3 feet; /* relative to the drawing's origin */
  float phase;
  int color; /* in the palette */
  vec3 x_axis, y_axis, z_axis; /* of the character, in the world */
  float scale;
};

vec4 of_agents(int number)
{
  return texelFetch(agents, ivec2(number % TEXELS, number / TEXELS), 0);
}

Agent agent(int number)
{
  vec4 first = of_agents(3 * number);
  vec4 second = of_agents(3 * number + 1);
  vec4 third = of_agents(3 * number + 2);
  Agent a;
  a.feet = first.xyz;
  a.phase = first.w;
  a.color = int(second.w);
  a.x_axis = second.xyz;
  a.y_axis = third.xyz;
  a.z_axis = cross(a.x_axis, a.y_axis);
  a.scale = third.w;
  return a;
}

vec3 oriented(Agent a, vec3 v)
{
  return a.x_axis * v.x + a.y_axis * v.y + a.z_axis * v.z;
}

#if defined(JOINTS) || defined(FRAMES)
/* The vertex at `phase` of the action whose frames begin at first_frame: two frames mixed linearly.
 * To mix their joints gives the same. */
Posed posed_at(float phase)
{
  float at = phase * float(frame_count - 1);
  int first = clamp(int(at), 0, max(frame_count - 2, 0));
  Posed before = posed(first_frame + first);
  Posed after = posed(first_frame + min(first + 1, frame_count - 1));
  float part = at - float(first);
  return Posed(mix(before.at, after.at, part), mix(before.facing, after.facing, part));
}
#endif
#endif
