"""`python -m bench`; `bench` itself takes the working directory off the path first."""

if __name__ == "__main__":
    from bench.cli import main

    main()
