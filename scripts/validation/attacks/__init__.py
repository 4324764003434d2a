"""Clean studies are spoilt in many ways: does anything wrong go unnoticed?"""
