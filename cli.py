from wobblesim.commands import main

main()
