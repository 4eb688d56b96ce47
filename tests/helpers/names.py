"""Names of scenes, methods and views that outputs must show as they are and no program may take for commands."""

NAMES = (
    "a$b", "$x^2$", "a_b", "_a", "50%", "#1", "R&D", "a~b", "a^b", "a\\b", "\\textbf{a}", "{a}", "}", "[red]",
    "[/red]", "[red]a[/red]", "a\\", "<script>alert(1)</script>", '"a"', "'a'", "=1+1", "+1", "-1", "@x", "a,b", "a;b",
    "a\nb", "\n=1+1", "a\rb", "a\tb", "\ta", "a\x1b[2Jb", "Büro", "熱画像", "مشهد", "\u202eevil", "🔥", ":fire:", 
    "n" * 200,
    "*", "a | b", "--", "e\u0301",
)  # fmt: skip
