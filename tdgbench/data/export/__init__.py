"""Write a scene as the systems read it whose own programs are to run on the same views."""
