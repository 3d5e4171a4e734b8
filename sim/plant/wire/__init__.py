"""How the plant's devices put things into bytes: register windows and frames, written anew, without input or output."""
