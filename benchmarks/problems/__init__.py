"""POMDPs with published results, written against the public model interface (`skd_adversary.pomdp.model`)."""
