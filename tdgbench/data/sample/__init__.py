"""Write a built-in scene as a folder of files, as a sample of what scenes look like."""
