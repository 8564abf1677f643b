"""The adversary's POMDP: objective × prediction of the car × sensor × road user, put together by one composer."""
