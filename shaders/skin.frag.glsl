void main()
{
  result = texel;
}
