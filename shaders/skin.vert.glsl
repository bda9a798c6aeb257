/* A vertex of a LOD mesh at a frame of the action (the instance), written to a pixel of a texture:
 * its place, and its normal packed. All frames are skinned once, so that an agent only mixes two. */
void main()
{
  Posed here = posed(gl_InstanceID);
  texel = vec4(here.at, coded(here.facing));
  vec2 pixel = (vec2(gl_VertexID, gl_InstanceID) + 0.5) / size;
  gl_Position = vec4(2.0 * pixel - 1.0, 0.0, 1.0);
  gl_PointSize = 1.0;
}
