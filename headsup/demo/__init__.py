"""The demo: a street, a server, five cars, and what each of them knew when."""
