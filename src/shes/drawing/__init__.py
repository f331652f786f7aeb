"""Drawing: pictures of one pose of a world, by MuJoCo's renderer or, without OpenGL, flat ones from above."""
