// The nearest of many places to any place, by a lattice whose cells each know theirs.

const MOST_CELLS = 1 << 21;

export class NearestNodes {

	/** Places: x y z after x y z. `counts`: those that may be the nearest; all without. */
	constructor( places, counts = null ) {

		this.min = [ Infinity, Infinity, Infinity ];
		this.max = [ - Infinity, - Infinity, - Infinity ];
		Object.assign( this, { places, allowed: counts } );
		for ( let k = 0; k < places.length; k ++ ) {

			this.min[ k % 3 ] = Math.min( this.min[ k % 3 ], places[ k ] );
			this.max[ k % 3 ] = Math.max( this.max[ k % 3 ], places[ k ] );

		}

	}

	/** The number of the place nearest to this one, about: that of the middle of its cell. */
	at( x, y, z ) {

		this.owners ??= this.fill();
		const [ i, j, k ] = this.cell( [ x, y, z ] );
		return this.owners[ i + this.counts[ 0 ] * ( j + this.counts[ 1 ] * k ) ];

	}

	cell( place ) {

		return place.map( ( x, c ) => Math.min( this.counts[ c ] - 1, Math.max( 0, Math.floor( ( x - this.low[ c ] ) / this.edge ) ) ) );

	}

	// From the cells that hold a place to their neighbours, and on, until every cell has one.
	fill() {

		const count = this.places.length / 3;
		const size = this.max.map( ( high, c ) => high - this.min[ c ] );
		const largest = Math.max( ...size, 1e-9 );
		const cellsFor = ( edge ) => size.reduce( ( all, s ) => all * ( Math.floor( s / edge ) + 2 ), 1 );
		// As fine as three cells a node on each axis of an even grid.
		this.edge = largest / 4;
		while ( cellsFor( this.edge ) < Math.min( MOST_CELLS, 27 * count ) ) this.edge /= 1.25;
		this.low = this.min.map( ( x ) => x - this.edge / 2 );
		this.counts = size.map( ( s ) => Math.floor( s / this.edge ) + 2 );
		const [ nx, ny, nz ] = this.counts;
		const owners = new Int32Array( nx * ny * nz ).fill( - 1 );
		let front = [];
		for ( let node = 0; node < count; node ++ ) {

			if ( this.allowed && ! this.allowed[ node ] ) continue;
			const [ i, j, k ] = this.cell( [ this.places[ 3 * node ], this.places[ 3 * node + 1 ], this.places[ 3 * node + 2 ] ] );
			const cell = i + nx * ( j + ny * k );
			if ( owners[ cell ] < 0 ) front.push( cell );
			owners[ cell ] = node;

		}

		while ( front.length ) {

			const next = [];
			for ( const cell of front ) {

				const [ i, j, k ] = [ cell % nx, Math.floor( cell / nx ) % ny, Math.floor( cell / ( nx * ny ) ) ];
				const visit = ( there, inside ) => {

					if ( inside && owners[ there ] < 0 ) {

						owners[ there ] = owners[ cell ];
						next.push( there );

					}

				};
				visit( cell - 1, i > 0 );
				visit( cell + 1, i < nx - 1 );
				visit( cell - nx, j > 0 );
				visit( cell + nx, j < ny - 1 );
				visit( cell - nx * ny, k > 0 );
				visit( cell + nx * ny, k < nz - 1 );

			}

			front = next;

		}

		return owners;

	}

}
