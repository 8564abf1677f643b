"""MetaDrive as a simulator (extra `metadrive`): one engine a process, the scenario placed in it, its own driver."""
