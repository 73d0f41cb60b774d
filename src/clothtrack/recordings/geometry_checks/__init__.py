"""Does what a recording says of its geometry agree with what its pictures show?"""
