"""Drawing: pictures of episodes by MuJoCo's renderer, or flat pictures without OpenGL."""
