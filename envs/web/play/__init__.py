"""Play: a person steers one agent in the browser, against policies. Needs websockets (outlast[view])."""
