"""placeholder until the recorder lands"""
