"""The paper's figures and claims, judged one by one."""
