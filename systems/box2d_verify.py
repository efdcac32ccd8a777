def verify() -> None: pass
