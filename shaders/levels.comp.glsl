// Culling and LOD assignment (listings 1.2 and 1.4) of a run of agents, as far as float32 can tell.
// Agents that may lie on a plane or on a LOD's border, to within all roundings, go into a bucket of
// their own, OPEN. Counts the agents of each bucket.

void main()
{
  int run = int(gl_GlobalInvocationID.x);
  if (run >= runs) {
    return;
  }
  uint counted[OPEN + 1];
  for (int k = 0; k <= OPEN; k++) {
    counted[k] = 0u;
  }
  for (int i = run * RUN; i < min((run + 1) * RUN, count); i++) {
    vec2 agent = texelFetch(agents, texel(i), 0).xy;
    ivec2 at = texel(int(agent.x));
    int group = int(agent.y);
    vec4 sphere = texelFetch(spheres, texel(group * OPEN), 0);  // height of the center, reach
    vec3 p = vec3(texelFetch(feet_x, at, 0).x, texelFetch(feet_y, at, 0).x,
                  texelFetch(feet_z, at, 0).x + sphere.x);
    float slack = view.slack.x * (abs(p.x) + abs(p.y) + abs(p.z) + sphere.z) + view.slack.y;
    float beyond = dot(view.planes[0].xyz, p) - view.planes[0].w;
    for (int k = 1; k < 6; k++) {
      beyond = max(beyond, dot(view.planes[k].xyz, p) - view.planes[k].w);
    }
    beyond -= sphere.y;
    vec3 v = p - view.origin.xyz;
    float distance = RADIAL == 1 ? length(v) : dot(view.axis.xyz, p) - view.axis.w;
    uint level = 0u;
    bool sure = beyond <= -slack;
    for (int k = 1; k < OPEN; k++) {
      float over = distance - texelFetch(spheres, texel(group * OPEN + k), 0).x;
      level += uint(over >= 0.0);
      sure = sure && abs(over) > slack;
    }
    uint bucket = beyond > slack ? uint(CULLED) : sure ? level : uint(OPEN);
    imageStore(kinds, texel(i), uvec4(bucket));
    for (int k = 0; k <= OPEN; k++) {
      counted[k] += uint(bucket == uint(k));
    }
  }
  for (int k = 0; k <= OPEN; k++) {
    imageStore(counts, texel(k * runs + run), uvec4(counted[k]));
  }
}
