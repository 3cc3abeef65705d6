"""What photographs tell by themselves: rays of all poses as a function of cameras, scale bars and air."""
