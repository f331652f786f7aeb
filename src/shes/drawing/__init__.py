"""Drawing: pictures of a simulation with MuJoCo's renderer, or flat ones where there is no OpenGL."""
